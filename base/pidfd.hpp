// SPDX-License-Identifier: Apache-2.0
//
// Pidfd: a process that cannot be mistaken for another one.
//
// Readable means that no thread of the process runs any more and none of its stores follows
// (docs/protocol.md, facts on pidfds). While it is not readable, the pid is not given to anybody
// else; after that a pid says nothing.
#pragma once

#include <agnocast/result.hpp>
#include <base/unique_fd.hpp>

#include <sys/types.h>

#include <cstdint>
#include <optional>
#include <utility>

namespace agnocast {

class Pidfd {
 public:
  Pidfd() = default;
  /// Takes over a pidfd (of SO_PEERPIDFD, or a descriptor store).
  explicit Pidfd(UniqueFd fd) noexcept : fd_(std::move(fd)) {}

  /// The process that has `pid` now, CLOEXEC. Errors: os_failure with errno (ESRCH: nobody).
  [[nodiscard]] static Result<Pidfd> open(pid_t pid) noexcept;

  /// Whether the process has ended; never sleeps. For epoll: ended is EPOLLIN.
  bool ended() const noexcept;
  /// A number that no other process of this boot has or will have. Empty before Linux 6.9, where
  /// pidfds have no inode of their own.
  std::optional<std::uint64_t> inode() const noexcept;
  /// The user namespace of the process, as an inode number; never sleeps. Empty before Linux 6.11, when the
  /// process has ended and when it may not be looked at.
  std::optional<std::uint64_t> user_namespace() const noexcept;

  int fd() const noexcept { return fd_.get(); }
  explicit operator bool() const noexcept { return static_cast<bool>(fd_); }
  UniqueFd release() noexcept { return std::move(fd_); }

 private:
  UniqueFd fd_;
};

/// Whether both name one process. `known` must be of a process that may still be alive: false once
/// it has ended. Opens files of /proc where pidfds have no inode; false when it cannot. Tests take
/// the inodes away; everybody else passes nothing.
bool same_process(const Pidfd& known, const Pidfd& other, bool has_inodes = true) noexcept;

/// When the process with `pid` began, in clock ticks since boot (/proc/PID/stat): with the pid, the
/// identity of a process where pidfds have no inode. Empty when there is none. To be believed only
/// if a pidfd of it has not ended afterwards.
std::optional<std::uint64_t> start_time_of(pid_t pid) noexcept;

/// The user namespace of the process with `pid`, as an inode number. Empty when there is no such
/// process or it may not be looked at. To be believed only if a pidfd of it has not ended
/// afterwards. Looks into /proc/PID, a directory that any user can keep locked (who reads it into memory that
/// does not come, and who changes its mode): for threads that may wait.
std::optional<std::uint64_t> user_namespace_of(pid_t pid) noexcept;

}  // namespace agnocast
