// SPDX-License-Identifier: Apache-2.0

#include <base/memfd.hpp>

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>

#include <cerrno>
#include <charconv>

#ifndef MFD_NOEXEC_SEAL
#define MFD_NOEXEC_SEAL 0x0008U  // Linux 6.3, not in glibc 2.36
#endif

namespace agnocast {

Result<UniqueFd> make_memfd(const char* name, std::uint64_t bytes) noexcept {
  UniqueFd fd(::memfd_create(name, MFD_CLOEXEC | MFD_ALLOW_SEALING | MFD_NOEXEC_SEAL));
  if (!fd && errno == EINVAL) fd.reset(::memfd_create(name, MFD_CLOEXEC | MFD_ALLOW_SEALING));
  if (!fd) return fail(Errc::os_failure, "creating a memfd", errno);
  if (::fchmod(fd.get(), 0600) != 0)
    return fail(Errc::os_failure, "restricting a memfd to its owner", errno);
  if (::ftruncate(fd.get(), static_cast<off_t>(bytes)) != 0)
    return fail(Errc::os_failure, "sizing a memfd", errno);
  if (::fcntl(fd.get(), F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) != 0) {
    return fail(Errc::os_failure, "sealing a memfd", errno);
  }
  return fd;
}

Result<UniqueFd> reopen_read_only(int fd) noexcept {
  char path[32] = "/proc/self/fd/";
  constexpr std::size_t prefix = sizeof "/proc/self/fd/" - 1;
  *std::to_chars(path + prefix, path + sizeof path - 1, fd).ptr = '\0';
  UniqueFd reader(::open(path, O_RDONLY | O_CLOEXEC));
  if (!reader) return fail(Errc::os_failure, "re-opening a memfd for reading", errno);
  return reader;
}

}  // namespace agnocast
