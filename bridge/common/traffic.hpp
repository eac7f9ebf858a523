// SPDX-License-Identifier: Apache-2.0
//
// Traffic: counters of one endpoint, updated where messages pass; and the cost of a held message.
#pragma once

#include <base/clock.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/status.hpp>

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>

namespace agnocast::bridge {

/// One direction of one endpoint, since its creation. Any thread.
struct Traffic {
  std::atomic<std::uint64_t> messages{0};
  std::atomic<std::uint64_t> bytes{0};           // as CDR
  std::atomic<std::uint64_t> unacknowledged{0};  // dropped: a reader in DDS does not acknowledge
  std::atomic<std::uint64_t> refused{0};         // not written or not published; see the log
  std::atomic<std::uint64_t> last_ns{0};         // of the newest message, monotonic
  const std::uint64_t since_ns = monotonic_ns();
  Seldom reports;  // limits log lines

  void count(std::size_t message_bytes) noexcept {
    ++messages;
    bytes += message_bytes;
    last_ns = monotonic_ns();
  }
  TrafficNumbers numbers() const noexcept {
    return {messages, bytes, unacknowledged, refused, since_ns, last_ns};
  }
};

/// The bound, as CDR, for messages held in all: for publishers that are not known yet, and behind
/// keep-all. Two seconds of a gigabit link, more than a history of ten point clouds. Messages
/// beyond it are dropped and counted. Each counts as at least a KiB, the cost of holding it.
inline constexpr std::size_t held_bytes_max = std::size_t{256} << 20;
inline std::size_t held_bytes_of(std::size_t bytes) noexcept {
  return std::max<std::size_t>(bytes, 1024);
}

}  // namespace agnocast::bridge
