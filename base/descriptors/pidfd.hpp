// SPDX-License-Identifier: Apache-2.0
//
// Pidfd: a reference to one process that cannot mean another one.
//
// Readable means that no thread of the process runs any more and no store of it follows
// (docs/protocol.md, facts on pidfds). While it is not readable, the kernel does not reuse the
// pid; after that a pid identifies nothing.
#pragma once

#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>

#include <sys/types.h>

#include <cstdint>
#include <optional>
#include <utility>

namespace agnocast {

class Pidfd {
 public:
  Pidfd() = default;
  /// Takes over a pidfd (from SO_PEERPIDFD, or a descriptor store).
  explicit Pidfd(UniqueFd fd) noexcept : fd_(std::move(fd)) {}

  /// Opens the process that has `pid` now, CLOEXEC. Errors: os_failure with errno (ESRCH: none).
  [[nodiscard]] static Result<Pidfd> open(pid_t pid) noexcept;

  /// Returns whether the process has ended; never sleeps. For epoll: ended is EPOLLIN.
  bool ended() const noexcept;
  /// Returns a number unique among all processes of this boot. Empty before Linux 6.9, where
  /// pidfds have no inode of their own.
  std::optional<std::uint64_t> inode() const noexcept;
  /// Returns the user namespace of the process, as an inode number; never sleeps. Empty before
  /// Linux 6.11, if the process has ended, and if access is denied.
  std::optional<std::uint64_t> user_namespace() const noexcept;

  int fd() const noexcept { return fd_.get(); }
  explicit operator bool() const noexcept { return static_cast<bool>(fd_); }
  UniqueFd release() noexcept { return std::move(fd_); }

 private:
  UniqueFd fd_;
};

/// Returns whether both refer to one process. `known` must refer to a process that may still be
/// alive: false once it has ended. Opens files of /proc where pidfds have no inode; false if it
/// cannot. Tests disable the inodes; other callers use the default.
bool same_process(const Pidfd& known, const Pidfd& other, bool has_inodes = true) noexcept;

/// Returns the start time of the process with `pid`, in clock ticks since boot (/proc/PID/stat):
/// with the pid, the identity of a process where pidfds have no inode. Empty if there is none.
/// Valid only if a pidfd of it has not ended afterwards.
std::optional<std::uint64_t> start_time_of(pid_t pid) noexcept;

/// Returns the user namespace of the process with `pid`, as an inode number. Empty if there is no
/// such process or access is denied. Valid only if a pidfd of it has not ended afterwards. Reads
/// /proc/PID, a directory that any user can keep locked (by reading it into memory that never
/// arrives, or by changing its mode): for threads that may wait.
std::optional<std::uint64_t> user_namespace_of(pid_t pid) noexcept;

}  // namespace agnocast
