// SPDX-License-Identifier: Apache-2.0
//
// What recovery_bench and the processes that it starts have in common: the message, the topics, and what such a process does.
#pragma once

#include <agnocast/message_traits.hpp>
#include <agnocast/residency.hpp>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace agnocast::bench {

struct Sample {
  std::uint64_t number = 0;
  std::vector<std::uint8_t> bytes;
  ~Sample();
  /// When the last one of this process was destroyed; 0: none was since it was set.
  static inline std::atomic<std::int64_t> destroyed_ns{0};
};

constexpr const char* topic_of_dying_publisher = "/recovery/heard";
constexpr const char* topic_of_dying_subscriber = "/recovery/held";
constexpr const char* topic_of_stream = "/recovery/stream";
constexpr std::size_t stream_depth = 500;  // half a second: what is lost is lost, and not late

/// Reads a byte of each page.
void touch(const Sample& sample) noexcept;

/// The life of a started process; it says "ready" when it has what its role is about.
///   publisher BYTES    has published a message of that size, which stays in its queue
///   subscriber         holds the first message that comes, and has read it
///   stream             publishes every millisecond
///   idle TOPIC         has a publisher and a subscription
[[noreturn]] void be(const std::string& role, const std::string& argument);

}  // namespace agnocast::bench

template <>
struct agnocast::MessageTraits<agnocast::bench::Sample> {
  static constexpr const char* name = "bench/Sample";
  static void for_each_pointer(const agnocast::bench::Sample& sample,
                               PointerVisitor& visit) noexcept {
    visit("bytes", sample.bytes);
  }
};
