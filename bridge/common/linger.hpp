// SPDX-License-Identifier: Apache-2.0
//
// How long a route stays when its publisher or writer is gone, since the last messages may still be under way.
#pragma once

#include <algorithm>
#include <chrono>
#include <optional>

namespace agnocast::bridge {

using Time = std::chrono::steady_clock::time_point;

inline constexpr std::chrono::seconds linger{1};
/// Longer, while keep-all holds up what is still to be written: DDS's usual lease, after which a dead reader owes nothing.
inline constexpr std::chrono::seconds held_linger{10};

/// The earlier one; nothing is never.
inline std::optional<Time> earliest(std::optional<Time> a, std::optional<Time> b) noexcept {
  if (!a || !b) return a ? a : b;
  return std::min(*a, *b);
}

}  // namespace agnocast::bridge
