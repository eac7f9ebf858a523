// SPDX-License-Identifier: Apache-2.0
//
// Fingerprint of everything that two processes must agree on: sizes, offsets and limits of the
// shared regions and of the wire. Compared exactly when a client says hello and when a region is
// attached: two builds that differ in a layout never touch each other's memory.
#pragma once

#include <agnocast/abi/board.hpp>
#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/limits.hpp>
#include <agnocast/abi/wire.hpp>

#include <cstddef>
#include <cstdint>

namespace agnocast::abi {

// Raised by hand when the meaning of a word changes while its place does not.
inline constexpr std::uint64_t layout_version = 1;

constexpr std::uint64_t fingerprint() noexcept {
  // FNV-1a over the numbers, each as eight bytes: two different lists of numbers collide with
  // probability 2^-64.
  constexpr std::uint64_t numbers[] = {layout_version,
                                       cache_line_bytes,
                                       page_bytes,
                                       depth_max,
                                       ring_count,
                                       slot_count_max,
                                       near_slot_count,
                                       publisher_count_max,
                                       subscription_count_max,
                                       topic_count_max,
                                       client_count_max,
                                       window_count_max,
                                       executor_count_max,
                                       sizeof(QueueSlot),
                                       offsetof(QueueSlot, id),
                                       offsetof(QueueSlot, address),
                                       offsetof(QueueSlot, stamp_ns),
                                       offsetof(QueueSlot, size),
                                       sizeof(PublisherEndpoint),
                                       offsetof(PublisherEndpoint, head),
                                       offsetof(PublisherEndpoint, intent_op),
                                       offsetof(PublisherEndpoint, intent_sequence),
                                       offsetof(PublisherEndpoint, intent_slot),
                                       sizeof(LinkLine),
                                       offsetof(LinkLine, publisher_generation),
                                       offsetof(LinkLine, cursor),
                                       offsetof(LinkLine, hold),
                                       sizeof(ExecutorLine),
                                       sizeof(WindowEntry),
                                       offsetof(WindowEntry, frontier),
                                       sizeof(ClientRegionHeader),
                                       offsetof(ClientRegionHeader, activity),
                                       offsetof(ClientRegionHeader, window),
                                       offsetof(ClientRegionHeader, executor),
                                       sizeof(TopicHeader),
                                       offsetof(TopicHeader, publisher_high),
                                       offsetof(TopicHeader, subscription_high),
                                       sizeof(PublisherEntry),
                                       offsetof(PublisherEntry, qos),
                                       offsetof(PublisherEntry, final_head),
                                       sizeof(SubscriptionEntry),
                                       offsetof(SubscriptionEntry, executor),
                                       topic_bytes,
                                       wire::version,
                                       wire::packet_bytes_max,
                                       wire::name_bytes,
                                       sizeof(wire::Hello),
                                       sizeof(wire::Welcome),
                                       sizeof(wire::CreateEndpoint),
                                       sizeof(wire::EndpointCreated),
                                       sizeof(wire::Announcement)};
  std::uint64_t hash = 0xcbf29ce484222325;
  for (std::uint64_t number : numbers) {
    for (int byte = 0; byte < 8; ++byte)
      hash = (hash ^ (number >> 8 * byte & 0xff)) * 0x100000001b3;
  }
  return hash;
}

}  // namespace agnocast::abi
