// SPDX-License-Identifier: Apache-2.0

#include <base/memory/memfd.hpp>

#include <fcntl.h>
#include <linux/fs.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/stat.h>

#include <cerrno>
#include <charconv>

#ifndef MFD_NOEXEC_SEAL
#define MFD_NOEXEC_SEAL 0x0008U  // Linux 6.3, not in glibc 2.36
#endif

namespace agnocast {

Result<UniqueFd> make_memfd(const char* name, std::uint64_t bytes, Length length) noexcept {
  UniqueFd fd(::memfd_create(name, MFD_CLOEXEC | MFD_ALLOW_SEALING | MFD_NOEXEC_SEAL));
  if (!fd && errno == EINVAL) fd.reset(::memfd_create(name, MFD_CLOEXEC | MFD_ALLOW_SEALING));
  if (!fd) return fail(Errc::os_failure, "creating a memfd", errno);
  if (::fchmod(fd.get(), 0600) != 0)
    return fail(Errc::os_failure, "restricting a memfd to its owner", errno);
  if (::ftruncate(fd.get(), static_cast<off_t>(bytes)) != 0)
    return fail(Errc::os_failure, "sizing a memfd", errno);
  const int seals = F_SEAL_SHRINK | F_SEAL_SEAL | (length == Length::fixed ? F_SEAL_GROW : 0);
  if (::fcntl(fd.get(), F_ADD_SEALS, seals) != 0)
    return fail(Errc::os_failure, "sealing a memfd", errno);
  return fd;
}

Result<void> lengthen(int fd, std::uint64_t bytes) noexcept {
  struct stat file {};
  if (::fstat(fd, &file) != 0) return fail(Errc::os_failure, "looking at a memfd", errno);
  if (static_cast<std::uint64_t>(file.st_size) >= bytes) return {};
  if (::ftruncate(fd, static_cast<off_t>(bytes)) != 0)
    return fail(Errc::os_failure, "lengthening a memfd", errno);
  return {};
}

Result<void> forbid_holes(int fd) noexcept {
  int flags = 0;
  if (::ioctl(fd, FS_IOC_GETFLAGS, &flags) == 0) {
    flags |= FS_IMMUTABLE_FL;
    if (::ioctl(fd, FS_IOC_SETFLAGS, &flags) == 0) return {};
  }
  return fail(Errc::os_failure, "forbidding holes in a memfd", errno);
}

Result<UniqueFd> reopen_read_only(int fd) noexcept {
  char path[32] = "/proc/self/fd/";
  constexpr std::size_t prefix = sizeof "/proc/self/fd/" - 1;
  *std::to_chars(path + prefix, path + sizeof path - 1, fd).ptr = '\0';
  UniqueFd reader(::open(path, O_RDONLY | O_CLOEXEC));
  if (!reader) return fail(Errc::os_failure, "re-opening a memfd for reading", errno);
  return reader;
}

Result<void> lock_for_writing(int writer) noexcept {
  struct flock whole {};
  whole.l_type = F_WRLCK;
  whole.l_whence = SEEK_SET;
  if (::fcntl(writer, F_OFD_SETLK, &whole) == 0) return {};
  return fail(Errc::os_failure, "locking shared memory", errno);
}

}  // namespace agnocast
