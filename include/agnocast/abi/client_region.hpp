// SPDX-License-Identifier: Apache-2.0
//
// Client region: one memfd per process, written by that process alone, mapped read-only by its
// peers. Sparse; the daemon assigns extents for endpoints in whole pages.
//
//      0  header page      windows, wait sets
//   4096  extents …        publisher endpoints and subscription endpoints, in any order
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/abi/words.hpp>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace agnocast::abi {

using SharedWord = std::atomic<std::uint64_t>;
static_assert(SharedWord::is_always_lock_free && sizeof(SharedWord) == 8);

constexpr std::uint64_t whole_pages(std::uint64_t bytes) noexcept {
  return (bytes + page_bytes - 1) / page_bytes * page_bytes;
}

// One message in a publisher's queue.   W = the publisher's process; all others map it read-only.
//
//    0  id        u64  0 free · sequence live · retired_mark|sequence
//                      [sync:publish] release at P3; acquire at T3, seq_cst at T5
//    8  address   u64  inside a window; stable while id is live or a hold bit is set
//   16  stamp_ns  u64  CLOCK_MONOTONIC at commit; orders several publishers, and tells the age of
//                      a message to those that respect a lifespan: hints, never trusted
//   24  size      u64  sizeof the message object; readers check address + size
struct alignas(32) QueueSlot {
  SharedWord id;
  SharedWord address;
  SharedWord stamp_ns;
  SharedWord size;
};
static_assert(sizeof(QueueSlot) == 32 && offsetof(QueueSlot, address) == 8 &&
              offsetof(QueueSlot, stamp_ns) == 16 && offsetof(QueueSlot, size) == 24);

// Publisher endpoint, an extent of its process's client region.   W = that process; the daemon
// writes the initial head, and rolls back fields in recovery once the process is dead.
//
//    0  head      u64  sequence<<16 | slot of the newest message
//                      [sync:publish] COMMIT: release at P5, acquire at T1
//    8  persistent_id u64  0: not known yet; the same for the endpoints by which one publisher is
//                      in several sessions of its process, one after the other
//   16  inherited u64  sequence up to which messages were published in a previous session: history,
//                      for those that ask for it; 0 = none
//   24  published_bytes u64  of all messages together, what a reader may touch; for people
//   32  asserted_ns u64  CLOCK_MONOTONIC of the last assertion of its liveliness, or of its begin
//   64  intent         op, sequence, slot; read by the daemon after the owner's death
//   88  counters       adopted messages and bytes, refused publishes by reason; for people. They
//                      share the intent's line, which no other process reads while the owner lives
//  128  withdrawn[64] u64  two bits for each subscription of the topic: not served any more, and
//  why
//                      [sync:hold] release at E1, seq_cst at T5
//  640  order[R]  u64  sequence<<16 | slot, at sequence mod R
//                      [sync:publish] release at P4, acquire at T2
//    …  slot[N]        QueueSlot, from 640 + R×8
struct PublisherEndpoint {
  alignas(cache_line_bytes) SharedWord head;
  SharedWord persistent_id;
  SharedWord inherited;
  SharedWord published_bytes;
  SharedWord asserted_ns;
  alignas(cache_line_bytes) SharedWord intent_op;
  SharedWord intent_sequence;
  SharedWord intent_slot;
  SharedWord adopted_messages;
  SharedWord adopted_bytes;
  SharedWord refused_no_slot;
  SharedWord refused_would_block;
  SharedWord refused_heap_exhausted;
  alignas(cache_line_bytes) SharedWord withdrawn[subscription_count_max / withdrawals_per_word];
};
static_assert(subscription_count_max % withdrawals_per_word == 0);
static_assert(sizeof(PublisherEndpoint) == 640 && offsetof(PublisherEndpoint, withdrawn) == 128);
static_assert(offsetof(PublisherEndpoint, head) == 0 &&
              offsetof(PublisherEndpoint, persistent_id) == 8 &&
              offsetof(PublisherEndpoint, inherited) == 16 &&
              offsetof(PublisherEndpoint, published_bytes) == 24 &&
              offsetof(PublisherEndpoint, asserted_ns) == 32 &&
              offsetof(PublisherEndpoint, intent_op) == 64 &&
              offsetof(PublisherEndpoint, intent_sequence) == 72 &&
              offsetof(PublisherEndpoint, intent_slot) == 80 &&
              offsetof(PublisherEndpoint, adopted_messages) == 88 &&
              offsetof(PublisherEndpoint, refused_heap_exhausted) == 120);
constexpr std::uint64_t order_offset(std::uint64_t index) noexcept {
  return sizeof(PublisherEndpoint) + index * sizeof(SharedWord);
}
constexpr std::uint64_t slot_offset(std::uint64_t ring, std::uint64_t index) noexcept {
  return order_offset(ring) + index * sizeof(QueueSlot);
}

// State of one subscription towards one publisher; link[j] for the publisher with board index j.
// W = the subscriber's process; while it has not been answered, the daemon.
//
//    0  publisher_generation  u64  0 = not linked
//                                  [sync:link] seq_cst at J6, acquire at P9
//    8  cursor                u64  next sequence number wanted; not linked: where to begin, or 0
//                                  [sync:direct-free] release at T7, acquire at P9
//   16  hold[6]               u64  bit i = "I hold slot i", slots 0…383
//                                  [sync:hold] seq_cst at T4, release at L1, acquire at P9
struct alignas(cache_line_bytes) LinkLine {
  SharedWord publisher_generation;
  SharedWord cursor;
  SharedWord hold[near_slot_count / 64];
};
static_assert(sizeof(LinkLine) == 64 && offsetof(LinkLine, cursor) == 8 &&
              offsetof(LinkLine, hold) == 16);

// Messages that a subscription did not get, for diagnosis, and its persistent endpoint id.   W =
// the subscriber's process.
//
//    0  lost         u64  messages that fell out of its depth, or were gone when it looked
//    8  malformed    u64  of them, what no honest publisher writes
//   16  unreachable  u64  of them, what lies where this process cannot map it
//   24  persistent_id u64  not 0; the same for the endpoints by which one subscription is in
//                         several sessions of its process
//   32  expired      u64  messages older than their publisher's lifespan; not lost
struct alignas(cache_line_bytes) SubscriptionCounters {
  SharedWord lost;
  SharedWord malformed;
  SharedWord unreachable;
  SharedWord persistent_id;
  SharedWord expired;
};
static_assert(sizeof(SubscriptionCounters) == 64 &&
              offsetof(SubscriptionCounters, malformed) == 8 &&
              offsetof(SubscriptionCounters, unreachable) == 16 &&
              offsetof(SubscriptionCounters, persistent_id) == 24 &&
              offsetof(SubscriptionCounters, expired) == 32);

// Subscription endpoint. All zero at join but for the cursors of J4.
//
//      0  SubscriptionCounters, in a page of its own
//   4096  link block of publishers 0…255; in wide topics further ones for the next 256, …
//
// A link block is parts of 16 KiB, a line of 64 bytes for each publisher in each: first the link
// lines, then the hold words of slots 384…895, then of the next 512, … So the daemon backs of a
// block, from its beginning, what the deepest queue needs.
inline constexpr std::uint64_t hold_words_per_line = cache_line_bytes / sizeof(SharedWord);
inline constexpr std::uint64_t far_hold_word_count = (slot_count_max - near_slot_count) / 64;  // 58
inline constexpr std::uint64_t link_part_bytes = link_block_count * cache_line_bytes;
static_assert(link_part_bytes % page_bytes == 0);
inline constexpr std::uint64_t link_block_bytes =
    (1 + (far_hold_word_count + hold_words_per_line - 1) / hold_words_per_line) * link_part_bytes;
constexpr std::uint64_t link_block_offset(std::uint64_t publisher) noexcept {
  return page_bytes + publisher / link_block_count * link_block_bytes;
}
constexpr std::uint64_t link_offset(std::uint64_t publisher) noexcept {
  return link_block_offset(publisher) + publisher % link_block_count * sizeof(LinkLine);
}
/// From the link line.
constexpr std::uint64_t far_hold_offset(std::uint64_t word) noexcept {
  return (1 + word / hold_words_per_line) * link_part_bytes +
         word % hold_words_per_line * sizeof(SharedWord);
}
/// Returns how many bytes of a link block are used if no publisher has more slots.
constexpr std::uint64_t used_link_bytes(std::uint64_t slot_count) noexcept {
  const std::uint64_t far = slot_count > near_slot_count ? slot_count - near_slot_count : 0;
  const std::uint64_t slots_per_part = hold_words_per_line * 64;
  return (1 + (far + slots_per_part - 1) / slots_per_part) * link_part_bytes;
}
static_assert(used_link_bytes(near_slot_count) == link_part_bytes &&
              used_link_bytes(slot_count_max) == link_block_bytes);

// One wait set's sleep word.   W = the process that sleeps.
//
//    0  armed  u64  generation; odd = asleep or about to sleep
//                   [sync:sleep] relaxed + fence at S1/S2, relaxed at P8
struct alignas(cache_line_bytes) WaitSetLine {
  SharedWord armed;
};
static_assert(sizeof(WaitSetLine) == 64);

// A heap window, as written by its owner. Peers take base and length from the daemon's
// announcement, and read only the frontier here.
//
//    0  base      u64  address
//    8  length    u64  bytes
//   16  frontier  u64  bytes from base that are in use, a multiple of the page; only grows
//                      [sync:frontier] release, acquire at T6
struct alignas(32) WindowEntry {
  SharedWord base;
  SharedWord length;
  SharedWord frontier;
  SharedWord reserved;
};
static_assert(sizeof(WindowEntry) == 32 && offsetof(WindowEntry, frontier) == 16);

// First page of a client region.   W = its process, except magic, fingerprint and generation,
// which the daemon writes before it sends the region.
//
//     0  magic         u64
//     8  fingerprint   u64
//    16  generation    u64  of the client
//   128  window[8]     WindowEntry
//   512  wait_set[56]  WaitSetLine
struct ClientRegionHeader {
  SharedWord magic;
  SharedWord fingerprint;
  SharedWord generation;
  alignas(2 * cache_line_bytes) WindowEntry window[window_count_max];
  alignas(cache_line_bytes) std::byte reserved[128];
  WaitSetLine wait_set[wait_set_count_max];
};
inline constexpr std::uint64_t client_region_magic =
    0x67657263742e6761;  // "ag.tcreg" in memory order
static_assert(offsetof(ClientRegionHeader, window) == 128 &&
              offsetof(ClientRegionHeader, wait_set) == 512);
static_assert(sizeof(ClientRegionHeader) == page_bytes);
static_assert(std::is_standard_layout_v<ClientRegionHeader>);

// Extent sizes of endpoints: whole pages, enough for the largest geometry.
inline constexpr std::uint64_t publisher_extent_bytes =
    whole_pages(slot_offset(ring_count, slot_count_max));
constexpr std::uint64_t subscription_extent_bytes(std::uint64_t link_blocks) noexcept {
  return link_block_offset(link_blocks * link_block_count);
}

}  // namespace agnocast::abi
