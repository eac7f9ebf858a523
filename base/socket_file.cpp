// SPDX-License-Identifier: Apache-2.0

#include <base/daemon_socket.hpp>
#include <base/socket_file.hpp>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>

namespace agnocast {

Result<UniqueFd> open_lock_file(const std::string& path) noexcept {
  UniqueFd lock(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (!lock && errno == ELOOP) return fail(Errc::permission_denied, "it is a symbolic link", errno);
  if (!lock) return fail(Errc::os_failure, "opening a lock file", errno);
  struct stat file {};
  if (::fstat(lock.get(), &file) != 0)
    return fail(Errc::os_failure, "a look at a lock file", errno);
  if (!S_ISREG(file.st_mode) || (file.st_uid != ::geteuid() && !is_unknown_user(file.st_uid)))
    return fail(Errc::permission_denied, "it is not a file of this user", EPERM);
  return lock;
}

bool set_mode_of_socket(const std::string& path, mode_t mode) noexcept {
  const UniqueFd entry(::open(path.c_str(), O_PATH | O_NOFOLLOW | O_CLOEXEC));
  struct stat file {};
  if (!entry || ::fstat(entry.get(), &file) != 0) return false;
  if (!S_ISSOCK(file.st_mode) || file.st_uid != ::geteuid()) {
    errno = EPERM;
    return false;
  }
  return ::chmod(("/proc/self/fd/" + std::to_string(entry.get())).c_str(), mode) == 0;
}

}  // namespace agnocast
