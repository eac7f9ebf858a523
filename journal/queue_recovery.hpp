// SPDX-License-Identifier: Apache-2.0
//
// Recovery of a dead publisher's queue: roll back or roll forward. docs/protocol.md, "Join,
// leave, death" (D3).
//
// The commit is one store (head, P5), so the intent beside head decides every interruption: rows
// @A to @F of cases.hpp; docs/recovery.md has the reason of each.
//
// The words of the dead process are input: copied once and checked. A vfork child of it may still
// write them after its death, so the result (the final head) goes to the board, which only the
// daemon writes.
#pragma once

#include <journal/cases.hpp>
#include <journal/steps.hpp>
#include <region/views.hpp>

#include <cstdint>

namespace agnocast::journal {

/// A publisher's intent and head as copied from its region.
struct IntentCopy {
  std::uint64_t op = 0;
  std::uint64_t sequence = 0;
  std::uint64_t slot = 0;
  std::uint64_t head = 0;  // commit word
};

/// Returns the matching row of cases.hpp.
constexpr const CaseRow<IntentDecision, 3>& intent_case(const IntentCopy& copy,
                                                        std::uint64_t slot_count) noexcept {
  const std::uint64_t committed = abi::sequence_of(copy.head);
  return case_of(intent::rows, {copy.op == abi::intent_idle      ? intent::idle
                                : copy.op == abi::intent_publish ? intent::publishing
                                                                 : intent::unknown,
                                copy.sequence == committed + 1 ? intent::next
                                : copy.sequence == committed   ? intent::committed
                                                               : intent::elsewhere,
                                copy.slot < slot_count ? intent::inside : intent::outside});
}
constexpr IntentDecision decide(const IntentCopy& copy, std::uint64_t slot_count) noexcept {
  return intent_case(copy, slot_count).decision;
}

/// Applies the decision to the dead publisher's queue and returns it; `final_head` receives the
/// commit word to record.
template <class M>
IntentDecision recover_queue(const region::PublisherWords<M>& words, std::uint64_t slot_count,
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
