// SPDX-License-Identifier: Apache-2.0
//
// Crash points: every numbered step of the protocol is a named place where tests may end the
// process with SIGKILL. Compiled only with AGNOCAST_CRASH_POINTS; release builds have the same
// source without them.
#pragma once

#include <base/step.hpp>

#include <cstdint>

#ifdef AGNOCAST_CRASH_POINTS

namespace agnocast::crash_points {

/// From now on the process dies at the n-th crash point (1-based) that it reaches; 0 = never.
/// Resets the count.
void arm(std::uint64_t n) noexcept;
/// Crash points reached since arm().
std::uint64_t reached() noexcept;

}  // namespace agnocast::crash_points

#endif
