// SPDX-License-Identifier: Apache-2.0

#include <base/mapping.hpp>

#include <sys/mman.h>

#include <cerrno>

namespace agnocast {

Result<Mapping> Mapping::map(int fd, std::uint64_t bytes, Access access) noexcept {
  const int protection = access == Access::read ? PROT_READ : PROT_READ | PROT_WRITE;
  void* at = ::mmap(nullptr, bytes, protection, MAP_SHARED, fd, 0);
  if (at == MAP_FAILED) return fail(Errc::os_failure, "mapping a shared region", errno);
  if (access == Access::read) ::madvise(at, bytes, MADV_DONTDUMP);
  return Mapping(static_cast<std::byte*>(at), bytes);
}

Result<Mapping> Mapping::reserve(std::uint64_t address, std::uint64_t bytes) noexcept {
  void* const wanted =
      reinterpret_cast<void*>(address);  // NOLINT: an address plan speaks in numbers
  const int flags =
      MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE | (address != 0 ? MAP_FIXED_NOREPLACE : 0);
  void* at = ::mmap(wanted, bytes, PROT_NONE, flags, -1, 0);
  if (at == MAP_FAILED) return fail(Errc::os_failure, "reserving addresses", errno);
  if (address != 0 && at != wanted) {  // a kernel before 4.17 takes the address as a hint
    ::munmap(at, bytes);
    return fail(Errc::os_failure, "reserving addresses", EEXIST);
  }
  return Mapping(static_cast<std::byte*>(at), bytes);
}

void Mapping::reset() noexcept {
  if (base_ != nullptr) ::munmap(base_, bytes_);
  base_ = nullptr;
  bytes_ = 0;
}

}  // namespace agnocast
