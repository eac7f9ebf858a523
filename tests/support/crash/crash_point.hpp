// SPDX-License-Identifier: Apache-2.0
//
// Crash points: every numbered step of the protocol is a named place where tests may end the
// process with SIGKILL, or delay it. Compiled only with AGNOCAST_CRASH_POINTS; release builds have
// the same source without them.
//
// A Control decides what happens at a point. It may lie in memory shared with the test: then the
// test arms a running process, and learns afterwards where it died. A process uses its own until
// it is given another, or finds AGNOCAST_CRASH_CONTROL=<file of sizeof(Control)> in its
// environment at start.
#pragma once

#include <base/step.hpp>

#include <agnocast/export.hpp>

#include <atomic>
#include <cstdint>

namespace agnocast::crash_points {

/// Plain words; zero means "nothing happens".
struct Control {
  std::atomic<std::uint64_t> reached;  // crash points so far
  std::atomic<std::uint64_t> deadly;   // the process dies at this one (1-based); 0 = never
  std::atomic<std::uint64_t> last;     // the Step at which it died, plus one; 0 = at none
  std::atomic<std::uint64_t>
      from;  // nothing counts before this Step, plus one; 0 = all points count
  std::atomic<std::uint64_t> until;  // nothing counts from this Step on, plus one; 0 = no end
  // Commits that the process's first thread has completed: it has reached a point after one.
  std::atomic<std::uint64_t> commits;
  std::atomic<std::uint64_t> then;  // its successor dies so many points later; 0 = never
  // Jitter: the seed and n decide what happens at the n-th point. Per million points:
  std::atomic<std::uint64_t> seed;
  std::atomic<std::uint64_t> sleeps;  // for up to jitter_ns_max, mostly far less
  std::atomic<std::uint64_t> deaths;
};
static_assert(std::atomic<std::uint64_t>::is_always_lock_free);

inline constexpr std::uint64_t jitter_ns_max = 3'000'000;

#ifdef AGNOCAST_CRASH_POINTS

/// From now on this process obeys `control`, which must stay mapped.
AGNOCAST_PUBLIC void use(Control& control) noexcept;

/// From now on the process dies at the n-th crash point (1-based) that it reaches; 0 = never.
/// Resets the count.
AGNOCAST_PUBLIC void arm(std::uint64_t n) noexcept;
/// Returns the number of crash points reached since arm().
AGNOCAST_PUBLIC std::uint64_t reached() noexcept;

#endif

}  // namespace agnocast::crash_points
