// SPDX-License-Identifier: Apache-2.0
//
// How long the bridge's threads sleep.
#pragma once

#include <chrono>

namespace agnocast::bridge {

/// When nothing happens: practically for ever.
inline constexpr auto no_end = std::chrono::hours(24 * 365);
/// Between two attempts to reach an absent daemon.
inline constexpr std::chrono::milliseconds daemon_interval(1'000);

}  // namespace agnocast::bridge
