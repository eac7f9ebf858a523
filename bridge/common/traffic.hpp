// SPDX-License-Identifier: Apache-2.0
//
// Traffic: what went over one endpoint, counted where it goes; and what a message that is held costs.
#pragma once

#include <base/clock.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/status.hpp>

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>

namespace agnocast::bridge {

/// One direction of one endpoint, since it exists. Any thread.
struct Traffic {
  std::atomic<std::uint64_t> messages{0};
  std::atomic<std::uint64_t> bytes{0};           // as DDS carries them
  std::atomic<std::uint64_t> unacknowledged{0};  // given up: a reader in DDS does not acknowledge
  std::atomic<std::uint64_t> refused{0};         // not written or not published; the log says why
  std::atomic<std::uint64_t> last_ns{0};         // of the newest message, monotonic
  const std::uint64_t since_ns = monotonic_ns();
  Seldom tells;  // the log

  void count(std::size_t message_bytes) noexcept {
    ++messages;
    bytes += message_bytes;
    last_ns = monotonic_ns();
  }
  TrafficNumbers numbers() const noexcept {
    return {messages, bytes, unacknowledged, refused, since_ns, last_ns};
  }
};

/// What may be held in all, as CDR, for publishers that are not known yet, and of what keep-all holds up: two seconds of
/// a gigabit link, which is more than a history of ten point clouds. What is beyond is dropped and counted. A message
/// counts as a KiB at least, which is what the holding costs.
inline constexpr std::size_t held_bytes_max = std::size_t{256} << 20;
inline std::size_t held_bytes_of(std::size_t bytes) noexcept {
  return std::max<std::size_t>(bytes, 1024);
}

}  // namespace agnocast::bridge
