// SPDX-License-Identifier: Apache-2.0
//
// Board: the endpoints of every topic. One memfd, written by the daemon alone, mapped read-only
// by every client.
//
//      0  header page
//   4096  topic[4096], 260 KiB each: TopicHeader, publisher[2048], subscription[2048]
#pragma once

#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/limits.hpp>

#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace agnocast::abi {

//    0  magic  u64 · 8  fingerprint  u64 · 16  incarnation  u64    written once, before anybody sees it
struct BoardHeader {
  SharedWord magic;
  SharedWord fingerprint;
  SharedWord incarnation;  // of the daemon's tables; differs after their loss
};
inline constexpr std::uint64_t board_magic = 0x6472616f622e6761;  // "ag.board" in memory order
static_assert(sizeof(BoardHeader) == 24 && sizeof(BoardHeader) <= page_bytes);

//    0  epoch              u64  +1 after every change of an endpoint
//                               [sync:join] seq_cst store at J3, acquire at P7
//    8  word               u64  generation | state of the topic
//   64  publisher_high     u64  publisher indexes ever used: bound of every loop over them
//   72  subscription_high  u64  subscription indexes ever used
struct TopicHeader {
  alignas(cache_line_bytes) SharedWord epoch;
  SharedWord word;
  alignas(cache_line_bytes) SharedWord publisher_high;
  SharedWord subscription_high;
};
static_assert(sizeof(TopicHeader) == 128 && offsetof(TopicHeader, publisher_high) == 64 &&
              offsetof(TopicHeader, subscription_high) == 72);

//    0  word            u64  generation | state; written last, release  [sync:join]
//    8  policies        u64  of its quality of service
//   16  client          u64  index of the process
//   24  extent          u64  offset of its PublisherEndpoint in the client region, bytes
//   32  slot_count      u64  N; only grows
//   40  final_head      u64  head when it died or left; valid once the state is orphan
//   48  deadline_ns     u64  offered; 0 = none
//   56  lease_ns        u64  of liveliness, offered; 0 = none
struct alignas(cache_line_bytes) PublisherEntry {
  SharedWord word;
  SharedWord policies;
  SharedWord client;
  SharedWord extent;
  SharedWord slot_count;
  SharedWord final_head;
  SharedWord deadline_ns;
  SharedWord lease_ns;
};
static_assert(sizeof(PublisherEntry) == 64 && offsetof(PublisherEntry, policies) == 8 &&
              offsetof(PublisherEntry, slot_count) == 32 &&
              offsetof(PublisherEntry, final_head) == 40 &&
              offsetof(PublisherEntry, lease_ns) == 56);

//    0  word         u64  generation | state; written last, release  [sync:join]
//    8  policies     u64  of its quality of service
//   16  client       u64  index of the process
//   24  extent       u64  offset of its subscription endpoint in the client region, bytes
//   32  quota        u64  messages it may hold, per publisher
//   40  wait_set     u64  index of the wait set that it sleeps in
//   48  deadline_ns  u64  requested; 0 = none
//   56  lease_ns     u64  of liveliness, requested; 0 = none
struct alignas(cache_line_bytes) SubscriptionEntry {
  SharedWord word;
  SharedWord policies;
  SharedWord client;
  SharedWord extent;
  SharedWord quota;
  SharedWord wait_set;
  SharedWord deadline_ns;
  SharedWord lease_ns;
};
static_assert(sizeof(SubscriptionEntry) == 64 && offsetof(SubscriptionEntry, policies) == 8 &&
              offsetof(SubscriptionEntry, wait_set) == 40 &&
              offsetof(SubscriptionEntry, lease_ns) == 56);

constexpr std::uint64_t publisher_entry_offset(std::uint64_t index) noexcept {
  return sizeof(TopicHeader) + index * sizeof(PublisherEntry);
}
constexpr std::uint64_t subscription_entry_offset(std::uint64_t publishers,
                                                  std::uint64_t index) noexcept {
  return publisher_entry_offset(publishers) + index * sizeof(SubscriptionEntry);
}
inline constexpr std::uint64_t topic_bytes =
    whole_pages(subscription_entry_offset(publisher_count_max, subscription_count_max));
constexpr std::uint64_t topic_offset(std::uint64_t topic) noexcept {
  return page_bytes + topic * topic_bytes;
}
inline constexpr std::uint64_t board_bytes = topic_offset(topic_count_max);
static_assert(std::is_standard_layout_v<TopicHeader> && std::is_standard_layout_v<PublisherEntry>);

}  // namespace agnocast::abi
