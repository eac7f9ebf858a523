// SPDX-License-Identifier: Apache-2.0
//
// The subscriber's answer to each message of a latency measurement, sent to the publisher through
// a pipe after the message was checked, so that the next message meets two idle processes.
#pragma once

#include <cstdint>
#include <ctime>

namespace demo {

inline constexpr int ack_descriptor = 3;  // the demo puts the pipe's end there in both processes

enum class Road : std::uint32_t { agnocast, dds };

struct Ack {
  std::uint64_t number = 0;
  std::uint64_t received_ns = 0;
  Road road = Road::agnocast;
  std::uint32_t intact = 0;
};

/// CLOCK_MONOTONIC, the same clock in all processes.
inline std::uint64_t now_ns() noexcept {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return static_cast<std::uint64_t>(now.tv_sec) * 1000000000u +
         static_cast<std::uint64_t>(now.tv_nsec);
}

}  // namespace demo
