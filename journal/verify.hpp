// SPDX-License-Identifier: Apache-2.0
//
// Verify: the invariants of a topic as code. Reads shared regions like any other input and
// changes nothing.
//
// Called after every step of the tests, after recoveries, and by `agnocast-ctl verify`. A
// publisher or subscription in the middle of an operation may break some of them for a moment;
// the caller passes which endpoints are at rest. The table also names invariants of the whole
// system, which ctl/snapshot/audit.cpp checks.
#pragma once

#include <region/views.hpp>

#include <algorithm>
#include <cstdint>

namespace agnocast::journal {

// X(name, sentence)
#define AGNOCAST_INVARIANT_TABLE(X)                                                          \
  X(none, "every invariant holds")                                                           \
  X(queue_head, "head is not older than the first sequence of its generation")               \
  X(queue_slot_committed, "a used slot carries a sequence between the first and head")       \
  X(queue_slot_unique, "no two slots carry the same sequence")                               \
  X(queue_order, "a ring entry is not newer than head")                                      \
  X(queue_order_slot, "the ring entry of a live slot names that slot")                       \
  X(queue_intent, "the intent of a publisher at rest is idle")                               \
  X(link_cursor, "a cursor lies between the first sequence and one past head")               \
  X(link_unlinked_zero, "a line that is not linked holds nothing")                           \
  X(hold_slot_used, "a held slot is in use")                                                 \
  X(hold_behind_cursor, "a held message was taken: its sequence is behind the cursor")       \
  X(queue_intent_known, "an intent has a known value")                                       \
  X(queue_address, "the message of a used slot lies in a window, below its frontier")        \
  X(link_generation, "a line is linked to the publisher that has its index, or to none")     \
  X(hold_quota, "a subscription holds no more of a publisher than its quota")                \
  X(region_header, "a client region names its process")                                      \
  X(region_readable, "a region is as long as its extents")                                   \
  X(window_header, "a process describes its windows as the daemon assigned them")            \
  X(window_frontier, "a frontier is a whole number of pages and lies in its window")         \
  X(window_inside, "every window lies in the arena")                                         \
  X(window_overlap, "no two windows overlap")                                                \
  X(extent_inside, "an extent begins with a page and lies in its region, behind the header") \
  X(extent_overlap, "no two extents of a process overlap")                                   \
  X(board_endpoint, "an endpoint's entry on the board is as the daemon knows it")            \
  X(board_free, "an unused index is free on the board")                                      \
  X(endpoint_process, "an endpoint belongs to a registered process")

enum class Invariant : std::uint8_t {
#define AGNOCAST_INVARIANT_ENUMERATOR(name, sentence) name,
  AGNOCAST_INVARIANT_TABLE(AGNOCAST_INVARIANT_ENUMERATOR)
#undef AGNOCAST_INVARIANT_ENUMERATOR
};

constexpr const char* sentence_of(Invariant invariant) noexcept {
  constexpr const char* sentences[] = {
#define AGNOCAST_INVARIANT_SENTENCE(name, sentence) sentence,
      AGNOCAST_INVARIANT_TABLE(AGNOCAST_INVARIANT_SENTENCE)
#undef AGNOCAST_INVARIANT_SENTENCE
  };
  return sentences[static_cast<std::uint8_t>(invariant)];
}

/// The wrong words: equal ones in a second check are the same fault, not another operation in
/// progress.
struct Witness {
  std::uint64_t place = 0;  // slot, ring entry or hold word
  std::uint64_t word = 0;   // its value
};

/// Checks one publisher's queue. `at_rest`: the publisher has no operation in progress (or its
/// process is dead and recovered).
template <class M>
Invariant verify_queue(const region::PublisherWords<M>& words, std::uint64_t first_sequence,
                       std::uint64_t slot_count, bool at_rest,
                       Witness* witness = nullptr) noexcept {
  const auto broken = [&](Invariant which, std::uint64_t place, std::uint64_t word) {
    if (witness != nullptr) *witness = {place, word};
    return which;
  };
  const std::uint64_t head = abi::sequence_of(words.head().load(std::memory_order_acquire));
  if (head < first_sequence) return broken(Invariant::queue_head, 0, head);
  const std::uint64_t intent = words.intent_op().load(std::memory_order_acquire);
  if (intent != abi::intent_idle && intent != abi::intent_publish)
    return broken(Invariant::queue_intent_known, 0, intent);
  for (std::uint64_t i = 0; i < slot_count; ++i) {
    const std::uint64_t id = words.slot_id(i).load(std::memory_order_acquire);
    if (id == 0) continue;
    const std::uint64_t sequence = id & ~abi::retired_mark;
    if (at_rest && (sequence <= first_sequence || sequence > head))
      return broken(Invariant::queue_slot_committed, i, id);
    for (std::uint64_t j = 0; j < i; ++j) {
      if ((words.slot_id(j).load(std::memory_order_relaxed) & ~abi::retired_mark) == sequence)
        return broken(Invariant::queue_slot_unique, i, id);
    }
    const std::uint64_t entry = words.order(sequence).load(std::memory_order_acquire);
    if (at_rest && abi::sequence_of(entry) == sequence && abi::slot_of(entry) != i)
      return broken(Invariant::queue_order_slot, i, entry);
    if (at_rest && id == sequence && head - sequence < M::ring_count() &&
        entry != abi::pack_entry(sequence, i)) {
      return broken(Invariant::queue_order_slot, i, entry);
    }
  }
  for (std::uint64_t i = 0; at_rest && i < M::ring_count(); ++i) {
    const std::uint64_t entry = words.order(i).load(std::memory_order_acquire);
    if (abi::sequence_of(entry) > head) return broken(Invariant::queue_order, i, entry);
  }
  if (at_rest && intent != abi::intent_idle) return broken(Invariant::queue_intent, 0, intent);
  return Invariant::none;
}

/// Checks one link line of a subscription at rest against the queue it is linked to.
template <class M>
Invariant verify_link(const region::LinkWords<M>& link, const region::PublisherWords<M>& words,
                      std::uint64_t generation, std::uint64_t first_sequence,
                      std::uint64_t slot_count, Witness* witness = nullptr) noexcept {
  const auto broken = [&](Invariant which, std::uint64_t place, std::uint64_t word) {
    if (witness != nullptr) *witness = {place, word};
    return which;
  };
  const std::uint64_t linked = link.publisher_generation().load(std::memory_order_acquire);
  const std::uint64_t cursor = link.cursor().load(std::memory_order_acquire);
  const std::uint64_t head = abi::sequence_of(words.head().load(std::memory_order_acquire));
  const bool is_linked = linked == generation;
  if (is_linked && (cursor <= first_sequence || cursor > head + 1))
    return broken(Invariant::link_cursor, 0, cursor);
  // The words of the line itself may have bits beyond the last slot; those are wrong as well.
  const std::uint64_t end = std::max<std::uint64_t>(slot_count, M::near_slot_count());
  for (std::uint64_t word = 0; word * 64 < end; ++word) {
    for (std::uint64_t bits = link.hold(word).load(std::memory_order_acquire); bits != 0;
         bits &= bits - 1) {
      const std::uint64_t slot = word * 64 + static_cast<std::uint64_t>(__builtin_ctzll(bits));
      if (!is_linked) return broken(Invariant::link_unlinked_zero, word, bits);
      const std::uint64_t id =
          slot < slot_count ? words.slot_id(slot).load(std::memory_order_acquire) : 0;
      if (id == 0) return broken(Invariant::hold_slot_used, slot, 0);
      if ((id & ~abi::retired_mark) >= cursor)
        return broken(Invariant::hold_behind_cursor, slot, id);
    }
  }
  return Invariant::none;
}

}  // namespace agnocast::journal
