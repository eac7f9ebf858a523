// SPDX-License-Identifier: Apache-2.0

#include <base/descriptors/unique_fd.hpp>
#include <base/text/standard_error.hpp>

#include <fcntl.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>

namespace agnocast {
namespace {

ssize_t write_to(int fd, std::string_view text) noexcept {
  ssize_t written = 0;
  do {
    written = ::write(fd, text.data(), text.size());
  } while (written < 0 && errno == EINTR);
  return written;
}

ssize_t say(std::string_view text) noexcept {
  struct stat file {};
  if (::fstat(STDERR_FILENO, &file) != 0) return -1;
  if (S_ISSOCK(file.st_mode))
    return ::send(STDERR_FILENO, text.data(), text.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
  if (!S_ISFIFO(file.st_mode) && !S_ISCHR(file.st_mode)) return write_to(STDERR_FILENO, text);
  const UniqueFd own(
      ::open("/proc/self/fd/2", O_WRONLY | O_NONBLOCK | O_NOCTTY | O_APPEND | O_CLOEXEC));
  if (own) return write_to(own.get(), text);
  // Another user's pipe, or no free descriptor. This waits only if another process writes in
  // between.
  pollfd writable{STDERR_FILENO, POLLOUT, 0};
  return ::poll(&writable, 1, 0) == 1 ? write_to(STDERR_FILENO, text) : -1;
}

}  // namespace

bool say_on_stderr(std::string_view text) noexcept {
  return say(text) == static_cast<ssize_t>(text.size());
}

}  // namespace agnocast
