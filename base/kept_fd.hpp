// SPDX-License-Identifier: Apache-2.0
//
// Kept descriptors: those that a library keeps in a process that is not its own. The program around it may
// close what it did not open (close_range, a daemon that cleans up, a number closed twice) and open files
// of its own under the same numbers. The library must not write to those, map them or close them.
//
//   keep()        moves a descriptor to a high number, out of the way of what the program opens next, and
//                 remembers what is behind it
//   is_intact()   is that still there? One system call; before a descriptor is mapped or told to others
//   close()       of a number that was kept closes it only if it is intact: for what is linked with
//                 --wrap=close, so that no destructor is forgotten; elsewhere nothing is kept
//   lost_kept()   looks at all of them. A control thread does so once a second; when one is gone, nobody uses
//                 any of them without a look of its own (may_use())
//
// What rings a sleeper is not looked at each time: that would be a second system call for each message. Up
// to a second goes by before it is, and in it a number from the high range would have to be given out again.
// The kernel gives out the lowest one that is free.
//
// A table by number, without locks, because forked children close as well.
#pragma once

#include <base/unique_fd.hpp>

#include <atomic>
#include <cstdint>

namespace agnocast {

/// The same descriptor, close-on-exec, kept. Where no high number is free it has the number that it had.
UniqueFd keep(UniqueFd fd) noexcept;
/// Whether this number, if it was kept, is what it was then. Any thread; errno stays.
bool is_intact(int fd) noexcept;
/// Whether somebody else has closed a kept one: for good. Looks at all, a system call for each.
bool lost_kept() noexcept;

namespace detail {
inline constinit std::atomic<bool> has_lost_kept{false};
}
/// lost_kept() has said so. Any thread.
inline bool has_lost_kept() noexcept {
  return detail::has_lost_kept.load(std::memory_order_relaxed);
}
/// For descriptors that are used often. Any thread.
inline bool may_use(int fd) noexcept { return !has_lost_kept() || is_intact(fd); }

}  // namespace agnocast
