// SPDX-License-Identifier: Apache-2.0
//
// The dying processes and the bystanders of the case death: the message, the topics, and roles of
// processes. Each prints "ready" when it has done its work:
//
//   death-publisher BYTES    has published a message of that size, which stays in its queue
//   death-subscriber         holds the first message that arrives, and has read it
//   death-stream             publishes every millisecond
//   death-idle TOPIC         has a publisher and a subscription
#pragma once

#include <agnocast/message_traits.hpp>
#include <agnocast/residency.hpp>

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace agnocast::bench {

inline std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

struct Sample {
  std::uint64_t number = 0;
  std::vector<std::uint8_t> bytes;
  ~Sample();
  /// Time of the last destruction in this process; 0: none since it was reset.
  static inline std::atomic<std::int64_t> destroyed_ns{0};
};

constexpr const char* topic_of_dying_publisher = "/death/heard";
constexpr const char* topic_of_dying_subscriber = "/death/held";
constexpr const char* topic_of_stream = "/death/stream";
constexpr std::size_t stream_depth = 500;  // half a second: what is late by then counts as lost

/// Reads a byte of each page.
void touch(const Sample& sample) noexcept;

}  // namespace agnocast::bench

template <>
struct agnocast::MessageTraits<agnocast::bench::Sample> {
  static constexpr const char* name = "bench/Sample";
  static void for_each_pointer(const agnocast::bench::Sample& sample,
                               PointerVisitor& visit) noexcept {
    visit("bytes", sample.bytes);
  }
};
