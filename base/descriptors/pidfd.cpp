// SPDX-License-Identifier: Apache-2.0

#include <base/descriptors/pidfd.hpp>

#include <fcntl.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/vfs.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <string_view>

namespace agnocast {
namespace {

constexpr auto pidfs_magic = 0x50494446;  // PID_FS_MAGIC, Linux 6.9

struct ProcPath {
  char text[64];
  ProcPath(pid_t pid, const char* rest) noexcept {
    std::snprintf(text, sizeof text, "/proc/%ld/%s", static_cast<long>(pid), rest);
  }
};

}  // namespace

Result<Pidfd> Pidfd::open(pid_t pid) noexcept {
  UniqueFd fd(static_cast<int>(::syscall(SYS_pidfd_open, pid, 0)));  // CLOEXEC by itself
  if (!fd) return fail(Errc::os_failure, "opening a pidfd", errno);
  return Pidfd(std::move(fd));
}

bool Pidfd::ended() const noexcept {
  pollfd entry{fd_.get(), POLLIN, 0};
  while (::poll(&entry, 1, 0) < 0) {
    if (errno != EINTR) return false;  // ENOMEM: not known to have ended
  }
  return (entry.revents & (POLLIN | POLLHUP)) != 0;
}

std::optional<std::uint64_t> Pidfd::inode() const noexcept {
  struct statfs filesystem {};
  struct stat file {};
  if (::fstatfs(fd_.get(), &filesystem) != 0 || filesystem.f_type != pidfs_magic) return {};
  if (::fstat(fd_.get(), &file) != 0) return {};
  return file.st_ino;
}

std::optional<std::uint64_t> Pidfd::user_namespace() const noexcept {
  constexpr unsigned long get_user_namespace =
      _IO(0xFF, 9);  // PIDFD_GET_USER_NAMESPACE, Linux 6.11
  const UniqueFd its(::ioctl(fd_.get(), get_user_namespace, 0));
  struct stat file {};
  if (!its || ::fstat(its.get(), &file) != 0) return {};
  return file.st_ino;
}

namespace {

// Returns the pid in this process's pid namespace, from /proc/self/fdinfo; 0 or -1: none.
std::optional<long> pid_of(const Pidfd& process) noexcept {
  char path[64];
  std::snprintf(path, sizeof path, "/proc/self/fdinfo/%d", process.fd());
  const UniqueFd file(::open(path, O_RDONLY | O_CLOEXEC));
  if (!file) return {};
  char text[1024];
  const ssize_t bytes = ::read(file.get(), text, sizeof text - 1);
  if (bytes <= 0) return {};
  text[bytes] = '\0';
  const char* const line = std::strstr(text, "\nPid:");
  long pid = 0;
  if (line == nullptr || std::sscanf(line, "\nPid: %ld", &pid) != 1) return {};
  return pid;
}

}  // namespace

bool same_process(const Pidfd& known, const Pidfd& other, bool has_inodes) noexcept {
  const auto inode = known.inode();
  const auto other_inode = other.inode();
  if (has_inodes && inode && other_inode) return *inode == *other_inode && !known.ended();
  const auto pid = pid_of(known);
  const auto other_pid = pid_of(other);
  // The order matters: a process that has not ended after both reads pinned its number during
  // them.
  return pid && other_pid && *pid > 0 && *pid == *other_pid && !known.ended();
}

std::optional<std::uint64_t> start_time_of(pid_t pid) noexcept {
  const UniqueFd file(::open(ProcPath(pid, "stat").text, O_RDONLY | O_CLOEXEC));
  if (!file) return {};
  char text[1024];
  const ssize_t bytes = ::read(file.get(), text, sizeof text);
  if (bytes <= 0) return {};
  // "pid (name) state …": the name may contain anything, so count from its last parenthesis.
  std::string_view rest(text, static_cast<std::size_t>(bytes));
  const std::size_t name_end = rest.rfind(')');
  if (name_end == std::string_view::npos) return {};
  rest.remove_prefix(name_end + 1);
  for (int field = 2; field < 22; ++field) {  // starttime is field 22, the name was field 2
    const std::size_t space = rest.find(' ');
    if (space == std::string_view::npos) return {};
    rest.remove_prefix(space + 1);
  }
  std::uint64_t ticks = 0;
  const auto parsed = std::from_chars(rest.data(), rest.data() + rest.size(), ticks);
  if (parsed.ec != std::errc()) return {};
  return ticks;
}

std::optional<std::uint64_t> user_namespace_of(pid_t pid) noexcept {
  struct stat file {};
  if (::stat(ProcPath(pid, "ns/user").text, &file) != 0) return {};
  return file.st_ino;
}

}  // namespace agnocast
