// SPDX-License-Identifier: Apache-2.0
//
// Kept descriptors: descriptors of a library in a process that belongs to another program. That
// program may close descriptors it did not open (close_range, a cleaning daemon, a number closed
// twice) and open files of its own under the same numbers. The library must not write to those,
// map them or close them.
//
//   keep()        moves a descriptor to a high number, away from those that the program opens
//                 next, and remembers its identity
//   is_intact()   checks that identity. One system call; use it before mapping or sending one
//   close()       of a kept number closes it only if it is intact: for code linked with
//                 --wrap=close, so that no destructor is forgotten; elsewhere nothing is kept
//   lost_kept()   checks all of them. A control thread calls it once a second; once one is lost,
//                 every use needs a check of its own (may_use())
//
// Doorbells are not checked at each ring: that would be a second system call for each message. A
// loss goes unnoticed for up to a second, and matters only if the kernel reassigns a number from
// the high range in that time. The kernel assigns the lowest free number.
//
// A table by number, without locks, because forked children close as well.
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <atomic>
#include <cstdint>

namespace agnocast {

/// Returns the descriptor, close-on-exec and kept. It retains its number if no high number is
/// free.
UniqueFd keep(UniqueFd fd) noexcept;
/// Returns whether this number, if kept, is still the same file. Any thread; errno stays.
bool is_intact(int fd) noexcept;
/// Returns whether other code has closed a kept one; stays true. Checks all, one system call
/// each.
bool lost_kept() noexcept;

namespace detail {
inline constinit std::atomic<bool> has_lost_kept{false};
}
/// Returns whether lost_kept() has found one. Any thread.
inline bool has_lost_kept() noexcept {
  return detail::has_lost_kept.load(std::memory_order_relaxed);
}
/// Returns whether `fd` may be used; cheap enough for frequent use. Any thread.
inline bool may_use(int fd) noexcept { return !has_lost_kept() || is_intact(fd); }

}  // namespace agnocast
