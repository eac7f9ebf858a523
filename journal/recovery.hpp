// SPDX-License-Identifier: Apache-2.0
//
// Recovery of a dead publisher's queue: roll back or roll forward. docs/protocol.md §3.7 (D3) and
// its crash table.
//
// The commit is one store (head, P5), so the intent beside head decides every interruption:
//
//   label  intent.op   intent.sequence      decision      why it is right
//   @A     idle        any                  nothing       the last publish had finished, or none
//                                                         had begun
//   @B     publishing  head + 1             roll back     not committed: nobody has seen it; wipe
//                                                         slot and ring entry
//   @C     publishing  head                 roll forward  committed: only the pass is missing
//   @D     publishing  anything else        corrupt       no honest publisher writes it; touch
//                                                         nothing, count it
//   @E     unknown     any                  corrupt       likewise
//   @F     publishing  head + 1, slot >= N  corrupt       likewise: there is no such slot to wipe
//
// Whatever the dead process wrote is input: copied once, checked, and after a death still writable
// by a vfork child of it, so the result (the final head) goes to the board, which only the daemon
// writes.
#pragma once

#include <client/dataplane/views.hpp>

#include <cstdint>

namespace agnocast::journal {

enum class IntentDecision : std::uint8_t { nothing, roll_back, roll_forward, corrupt };

/// A publisher's intent and head as copied from its region.
struct IntentCopy {
  std::uint64_t op = 0;
  std::uint64_t sequence = 0;
  std::uint64_t slot = 0;
  std::uint64_t head = 0;  // commit word
};

/// The table above. Pure.
constexpr IntentDecision decide(const IntentCopy& copy, std::uint64_t slot_count) noexcept {
  const std::uint64_t committed = abi::sequence_of(copy.head);
  if (copy.op == abi::intent_idle) return IntentDecision::nothing;                      // @A
  if (copy.op != abi::intent_publish) return IntentDecision::corrupt;                   // @E
  if (copy.sequence == committed) return IntentDecision::roll_forward;                  // @C
  if (copy.sequence != committed + 1) return IntentDecision::corrupt;                   // @D
  return copy.slot < slot_count ? IntentDecision::roll_back : IntentDecision::corrupt;  // @B, @F
}

/// Carries out the decision on the dead publisher's queue and returns what was decided;
/// `final_head` is the commit word to record.
template <class M>
IntentDecision recover_queue(const dataplane::PublisherWords<M>& words, std::uint64_t slot_count,
                             std::uint64_t& final_head) noexcept {
  const IntentCopy copy{words.intent_op().load(std::memory_order_acquire),
                        words.intent_sequence().load(std::memory_order_relaxed),
                        words.intent_slot().load(std::memory_order_relaxed),
                        words.head().load(std::memory_order_acquire)};
  final_head = copy.head;
  const IntentDecision decision = decide(copy, slot_count);
  if (decision == IntentDecision::roll_back) {
    if (words.slot_id(copy.slot).load(std::memory_order_relaxed) == copy.sequence) {
      AGNOCAST_STEP(D3_slot) words.slot_id(copy.slot).store(0, std::memory_order_release);
    }
    if (abi::sequence_of(words.order(copy.sequence).load(std::memory_order_relaxed)) ==
        copy.sequence) {
      AGNOCAST_STEP(D3_order) words.order(copy.sequence).store(0, std::memory_order_release);
    }
  }
  if (decision == IntentDecision::roll_back || decision == IntentDecision::roll_forward) {
    AGNOCAST_STEP(D3_intent) words.intent_op().store(abi::intent_idle, std::memory_order_release);
  }
  return decision;
}

}  // namespace agnocast::journal
