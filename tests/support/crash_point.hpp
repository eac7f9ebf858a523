// SPDX-License-Identifier: Apache-2.0
//
// Crash points: every numbered step of the protocol is a named place where tests may end the
// process with SIGKILL, or hold it up. Compiled only with AGNOCAST_CRASH_POINTS; release builds
// have the same source without them.
//
// What happens at a point is said by a Control, which may lie in memory shared with the test: then
// the test arms a running process, and learns afterwards where it died. A process uses one of its
// own until it is told another, or finds AGNOCAST_CRASH_CONTROL=<file of sizeof(Control)> in its
// environment when it starts.
#pragma once

#include <base/step.hpp>

#include <agnocast/export.hpp>

#include <atomic>
#include <cstdint>

namespace agnocast::crash_points {

/// Plain words; zero is "nothing happens".
struct Control {
  std::atomic<std::uint64_t> reached;  // crash points so far
  std::atomic<std::uint64_t> deadly;   // the process dies at this one (1-based); 0 = never
  std::atomic<std::uint64_t> last;     // the Step it died at, plus one; 0 = at none
  std::atomic<std::uint64_t>
      from;  // nothing counts before this Step, plus one; 0 = everything does
  std::atomic<std::uint64_t> until;  // nothing counts from this Step on, plus one; 0 = no end
  // Commits that the thread that began the process has behind it: it has come to a point after one.
  std::atomic<std::uint64_t> commits;
  std::atomic<std::uint64_t> then;  // who comes after it dies so many points later; 0 = never
  // Jitter: what happens at the n-th point is a function of the seed and n. Per million points:
  std::atomic<std::uint64_t> seed;
  std::atomic<std::uint64_t> sleeps;  // for up to jitter_ns_max, mostly far less
  std::atomic<std::uint64_t> deaths;
};
static_assert(std::atomic<std::uint64_t>::is_always_lock_free);

inline constexpr std::uint64_t jitter_ns_max = 3'000'000;

#ifdef AGNOCAST_CRASH_POINTS

/// From now on this process does what `control` says; it must stay mapped.
AGNOCAST_PUBLIC void use(Control& control) noexcept;

/// From now on the process dies at the n-th crash point (1-based) that it reaches; 0 = never.
/// Resets the count.
AGNOCAST_PUBLIC void arm(std::uint64_t n) noexcept;
/// Crash points reached since arm().
AGNOCAST_PUBLIC std::uint64_t reached() noexcept;

#endif

}  // namespace agnocast::crash_points
