// SPDX-License-Identifier: Apache-2.0
//
// How long a route stays after its publisher or writer is gone, because last messages may still
// arrive.
#pragma once

#include <algorithm>
#include <chrono>
#include <optional>

namespace agnocast::bridge {

using Time = std::chrono::steady_clock::time_point;

inline constexpr std::chrono::seconds linger{1};
/// Longer while keep-all blocks pending messages: DDS's usual lease, after which a dead reader
/// counts no more.
inline constexpr std::chrono::seconds held_linger{10};

/// Returns the earlier time; no value means never.
inline std::optional<Time> earliest(std::optional<Time> a, std::optional<Time> b) noexcept {
  if (!a || !b) return a ? a : b;
  return std::min(*a, *b);
}

}  // namespace agnocast::bridge
