// SPDX-License-Identifier: Apache-2.0

#include <base/sockets/daemon_socket.hpp>
#include <base/sockets/socket_file.hpp>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>
#include <utility>

namespace agnocast {

tl::expected<void, SocketRefusal> check_socket_directory(const std::string& directory) {
  const auto refuse = [](Errc code, std::string what) {
    return tl::unexpected<SocketRefusal>(SocketRefusal{code, std::move(what)});
  };
  struct stat entry {};
  if (::stat(directory.c_str(), &entry) != 0)
    return refuse(Errc::os_failure, "cannot use directory " + directory + ": " +
                                        std::generic_category().message(errno));
  if (!S_ISDIR(entry.st_mode))
    return refuse(Errc::os_failure, "cannot use " + directory + ": it is not a directory");
  if (entry.st_uid != 0 && entry.st_uid != ::geteuid() && !is_unknown_user(entry.st_uid))
    return refuse(Errc::permission_denied, "cannot use directory " + directory + ": user " +
                                               std::to_string(entry.st_uid) +
                                               " owns it and could replace the socket");
  if ((entry.st_mode & 0022) != 0 && (entry.st_mode & S_ISVTX) == 0)
    return refuse(Errc::permission_denied,
                  "cannot use directory " + directory +
                      ": others may write there and could replace the socket");
  return {};
}

std::string directory_of(const std::string& path) {
  const std::size_t slash = path.rfind('/');
  if (slash == std::string::npos) return ".";
  return slash == 0 ? "/" : path.substr(0, slash);
}

Result<UniqueFd> open_lock_file(const std::string& path) noexcept {
  UniqueFd lock(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (!lock && errno == ELOOP) return fail(Errc::permission_denied, "it is a symbolic link", errno);
  if (!lock) return fail(Errc::os_failure, "opening a lock file", errno);
  struct stat file {};
  if (::fstat(lock.get(), &file) != 0) return fail(Errc::os_failure, "checking a lock file", errno);
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
