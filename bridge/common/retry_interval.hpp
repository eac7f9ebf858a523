// SPDX-License-Identifier: Apache-2.0
//
// The interval between two attempts to send messages for which a subscription of this host has no
// room. No event announces room, so the bridge polls; the interval doubles while nothing moves.
#pragma once

#include <algorithm>
#include <chrono>

namespace agnocast::bridge {

inline constexpr std::chrono::nanoseconds retry_interval_min = std::chrono::milliseconds(1),
                                          retry_interval_max = std::chrono::milliseconds(100);

inline std::chrono::nanoseconds retry_interval_after(std::chrono::nanoseconds interval,
                                                     bool has_moved) {
  return has_moved ? retry_interval_min
                   : std::clamp(2 * interval, retry_interval_min, retry_interval_max);
}

}  // namespace agnocast::bridge
