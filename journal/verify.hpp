// SPDX-License-Identifier: Apache-2.0
//
// Verify: the invariants of a topic as code. Reads shared regions like any other input and changes
// nothing.
//
// Called after every step of the tests, after recoveries, and by `agnocast-ctl verify`. A publisher
// or subscription that is in the middle of an operation may break some of them for a moment; the
// caller says which endpoints are at rest.
#pragma once

#include <client/dataplane/views.hpp>

#include <cstdint>

namespace agnocast::journal {

// X(name, sentence)
#define AGNOCAST_INVARIANT_TABLE(X)                                                    \
  X(none, "every invariant holds")                                                     \
  X(queue_head, "head is not older than the first sequence of its generation")         \
  X(queue_slot_committed, "a used slot carries a sequence between the first and head") \
  X(queue_slot_unique, "no two slots carry the same sequence")                         \
  X(queue_order, "a ring entry says nothing newer than head")                          \
  X(queue_order_slot, "the ring entry of a live slot names that slot")                 \
  X(queue_intent, "the intent of a publisher at rest is idle")                         \
  X(link_cursor, "a cursor lies between the first sequence and one past head")         \
  X(link_unlinked_zero, "a line that is not linked is zero")                           \
  X(hold_slot_used, "a held slot is in use")                                           \
  X(hold_behind_cursor, "what is held was taken: its sequence is behind the cursor")

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

/// One publisher's queue. `at_rest`: no operation of the publisher is under way (or its process is
/// dead and recovered).
template <class M>
Invariant verify_queue(const dataplane::PublisherWords<M>& words, std::uint64_t first_sequence,
                       std::uint64_t slot_count, bool at_rest) noexcept {
  const std::uint64_t head = abi::sequence_of(words.head().load(std::memory_order_acquire));
  if (head < first_sequence) return Invariant::queue_head;
  for (std::uint64_t i = 0; i < slot_count; ++i) {
    const std::uint64_t id = words.slot_id(i).load(std::memory_order_acquire);
    if (id == 0) continue;
    const std::uint64_t sequence = id & ~abi::retired_mark;
    if (at_rest && (sequence <= first_sequence || sequence > head))
      return Invariant::queue_slot_committed;
    for (std::uint64_t j = 0; j < i; ++j) {
      if ((words.slot_id(j).load(std::memory_order_relaxed) & ~abi::retired_mark) == sequence)
        return Invariant::queue_slot_unique;
    }
    const std::uint64_t entry = words.order(sequence).load(std::memory_order_acquire);
    if (at_rest && abi::sequence_of(entry) == sequence && abi::slot_of(entry) != i)
      return Invariant::queue_order_slot;
    if (at_rest && id == sequence && head - sequence < M::ring_count() &&
        entry != abi::pack_entry(sequence, i)) {
      return Invariant::queue_order_slot;
    }
  }
  for (std::uint64_t i = 0; at_rest && i < M::ring_count(); ++i) {
    if (abi::sequence_of(words.order(i).load(std::memory_order_acquire)) > head)
      return Invariant::queue_order;
  }
  if (at_rest && words.intent_op().load(std::memory_order_acquire) != abi::intent_idle)
    return Invariant::queue_intent;
  return Invariant::none;
}

/// One link line of a subscription at rest against the queue it is linked to.
template <class M>
Invariant verify_link(const dataplane::LinkWords<M>& link,
                      const dataplane::PublisherWords<M>& words, std::uint64_t generation,
                      std::uint64_t first_sequence, std::uint64_t slot_count) noexcept {
  const std::uint64_t linked = link.publisher_generation().load(std::memory_order_acquire);
  const std::uint64_t cursor = link.cursor().load(std::memory_order_acquire);
  const std::uint64_t head = abi::sequence_of(words.head().load(std::memory_order_acquire));
  const bool is_linked = linked == generation;
  if (linked == 0 && cursor != 0) return Invariant::link_unlinked_zero;
  if (is_linked && (cursor <= first_sequence || cursor > head + 1)) return Invariant::link_cursor;
  for (std::uint64_t word = 0; word * 64 < slot_count; ++word) {
    for (std::uint64_t bits = link.hold(word).load(std::memory_order_acquire); bits != 0;
         bits &= bits - 1) {
      const std::uint64_t slot = word * 64 + static_cast<std::uint64_t>(__builtin_ctzll(bits));
      if (!is_linked) return Invariant::link_unlinked_zero;
      const std::uint64_t id =
          slot < slot_count ? words.slot_id(slot).load(std::memory_order_acquire) : 0;
      if (id == 0) return Invariant::hold_slot_used;
      if ((id & ~abi::retired_mark) >= cursor) return Invariant::hold_behind_cursor;
    }
  }
  return Invariant::none;
}

}  // namespace agnocast::journal
