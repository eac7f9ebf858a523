// SPDX-License-Identifier: Apache-2.0

#include <base/memory/mapping.hpp>

#include <agnocast/abi/limits.hpp>
#include <base/descriptors/unique_fd.hpp>

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>

namespace agnocast {
namespace {

constexpr int reserved = MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE;

// After mlockall(MCL_FUTURE) mmap counts every new mapping against RLIMIT_MEMLOCK, with or without
// memory behind it. Growing an existing one counts only if that one is locked, so: one page,
// unlocked, grown to the whole.
void* reserve_unlocked(void* wanted, std::uint64_t bytes, int where) noexcept {
  void* const page = ::mmap(wanted, abi::page_bytes, PROT_NONE, reserved | where, -1, 0);
  if (page == MAP_FAILED) return MAP_FAILED;
  void* const whole = ::munlock(page, abi::page_bytes) == 0
                          ? ::mremap(page, abi::page_bytes, bytes, where != 0 ? 0 : MREMAP_MAYMOVE)
                          : MAP_FAILED;
  if (whole == MAP_FAILED) {
    const int why = errno;
    ::munmap(page, abi::page_bytes);
    errno = why;
  }
  return whole;
}

tl::unexpected<Failure> refusal_of(std::uint64_t bytes, const char* what) noexcept {
  const int why = errno;
  if (why == EAGAIN) return tl::unexpected(lock_refusal(bytes));
  if (why == ENOMEM) return tl::unexpected(no_memory(bytes, what));
  return fail(Errc::os_failure, what, why);
}

// The line "VmLck: N kB" of /proc/self/status, in bytes; 0 if it cannot be read.
std::uint64_t locked_bytes() noexcept {
  const UniqueFd status(::open("/proc/self/status", O_RDONLY | O_CLOEXEC));
  char text[4096];
  const ssize_t length = status ? ::read(status.get(), text, sizeof text - 1) : -1;
  if (length <= 0) return 0;
  text[length] = '\0';
  const char* const line = std::strstr(text, "\nVmLck:");
  return line != nullptr ? std::strtoull(line + std::strlen("\nVmLck:"), nullptr, 10) * 1024 : 0;
}

}  // namespace

bool locks_new_mappings() noexcept {
  const std::uint64_t before = locked_bytes();
  // A refused mapping has the same reason.
  const auto page = Mapping::map_private(1);
  return page ? locked_bytes() > before : page.error().code == Errc::lock_limit;
}

Failure lock_refusal(std::uint64_t bytes) noexcept {
  rlimit limit{};
  ::getrlimit(RLIMIT_MEMLOCK, &limit);
  char text[128];
  std::snprintf(
      text, sizeof text, "RLIMIT_MEMLOCK is %ju bytes, %ju are locked and %ju more are needed",
      std::uintmax_t{limit.rlim_cur}, std::uintmax_t{locked_bytes()}, std::uintmax_t{bytes});
  return failure_with(Errc::lock_limit, text);
}

Failure no_memory(std::uint64_t bytes, const char* what) noexcept {
  rlimit limit{};
  if (::getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY)
    return {Errc::os_failure, ENOMEM, what};
  char text[128];
  std::snprintf(text, sizeof text, "RLIMIT_AS is %ju bytes, %ju more are needed",
                std::uintmax_t{limit.rlim_cur}, std::uintmax_t{bytes});
  return failure_with(Errc::address_limit, text);
}

Result<Mapping> Mapping::map(int fd, std::uint64_t bytes, Access access) noexcept {
  const int protection = access == Access::read ? PROT_READ : PROT_READ | PROT_WRITE;
  void* at = ::mmap(nullptr, bytes, protection, MAP_SHARED, fd, 0);
  if (at == MAP_FAILED) return refusal_of(bytes, "mapping a shared region");
  if (access == Access::read) ::madvise(at, bytes, MADV_DONTDUMP);
  return Mapping(static_cast<std::byte*>(at), bytes);
}

Result<Mapping> Mapping::map_private(std::uint64_t bytes) noexcept {
  void* at = ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (at == MAP_FAILED) return refusal_of(bytes, "mapping private memory");
  return Mapping(static_cast<std::byte*>(at), bytes);
}

Result<Mapping> Mapping::reserve(std::uint64_t address, std::uint64_t bytes) noexcept {
  void* const wanted =
      reinterpret_cast<void*>(address);  // NOLINT: an address plan speaks in numbers
  const int where = address != 0 ? MAP_FIXED_NOREPLACE : 0;
  void* at = ::mmap(wanted, bytes, PROT_NONE, reserved | where, -1, 0);
  if (at == MAP_FAILED && errno == EAGAIN) at = reserve_unlocked(wanted, bytes, where);
  if (at == MAP_FAILED) return refusal_of(bytes, "reserving addresses");
  if (address != 0 && at != wanted) {  // a kernel before 4.17 takes the address as a hint
    ::munmap(at, bytes);
    return fail(Errc::os_failure, "reserving addresses", EEXIST);
  }
  return Mapping(static_cast<std::byte*>(at), bytes);
}

void Mapping::cover(std::byte* at, std::uint64_t bytes) noexcept {
  // Releasing many pages at once stalls every thread of the process at its next page fault, some
  // 80 ms for 1 GiB. So release slices, and replace an empty mapping. A refusal (locked pages)
  // costs only that delay.
  constexpr std::uint64_t slice_bytes = 16 << 20;
  for (std::uint64_t done = 0; bytes > slice_bytes && done < bytes; done += slice_bytes)
    ::madvise(at + done, std::min(slice_bytes, bytes - done), MADV_DONTNEED);
  if (::mmap(at, bytes, PROT_NONE, reserved | MAP_FIXED, -1, 0) != MAP_FAILED) return;
  // EAGAIN: the kernel counts the new mapping before it removes the old one.
  ::munmap(at, bytes);
  reserve_unlocked(at, bytes, MAP_FIXED_NOREPLACE);
}

void Mapping::reset() noexcept {
  if (base_ != nullptr) ::munmap(base_, bytes_);
  base_ = nullptr;
  bytes_ = 0;
}

}  // namespace agnocast
