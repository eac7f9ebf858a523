// SPDX-License-Identifier: Apache-2.0
//
// Who dies in the case death, and who stands by: the message, the topics, and roles of processes. Each says "ready" when it
// has what it is about.
//
//   death-publisher BYTES    has published a message of that size, which stays in its queue
//   death-subscriber         holds the first message that comes, and has read it
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
  /// When the last one of this process was destroyed; 0: none was since it was set.
  static inline std::atomic<std::int64_t> destroyed_ns{0};
};

constexpr const char* topic_of_dying_publisher = "/death/heard";
constexpr const char* topic_of_dying_subscriber = "/death/held";
constexpr const char* topic_of_stream = "/death/stream";
constexpr std::size_t stream_depth = 500;  // half a second: what is lost is lost, and not late

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
