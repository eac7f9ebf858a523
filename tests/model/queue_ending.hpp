// SPDX-License-Identifier: Apache-2.0
//
// QueueScenario: the invariants when no move is left.
#pragma once

#include <tests/model/queue_scenario.hpp>

namespace agnocast::model {

inline const char* QueueScenario::finished(const W& world) {
  const State& state = world.state;
  const std::uint64_t head = abi::sequence_of(peek(world, publisher_region, pe));
  const bool alive = state.publisher_dead == 0;
  if (world.threads[daemon_main].pc == down) return "the daemon stays down";
  if (!alive && state.publisher_dead != 3) return "a dead publisher was not recovered";
  for (std::uint32_t s = 0; s < 2; ++s) {
    if (!plan_.sub[s].present || state.sub_dead[s] != 0) continue;
    const std::uint64_t pc = world.threads[sub0 + s].pc;
    if (pc == left && plan_.sub[s].present) {
      for (std::uint64_t field = 0; field < 3; ++field) {
        if (peek_line(world, s, field) != 0) return "a link that is gone left its line set";
      }
    }
    if (pc == left || pc == hung) continue;
    if (pc != blocked && pc != served) return "a subscription is stuck";
    const SubscriptionPrivate& own = sub_private(world, s);
    if (!alive || plan_.publisher_leaves)
      return "a subscription of a publisher that is gone did not finish";
    if (own.link.cursor() <= head && !is_withdrawn(state, s))
      return "a subscription sleeps beside a message";
  }
  if (alive) {
    const PublisherPrivate& own = publisher_private(world);
    if (world.threads[publisher_main].pc == wait_for_room && !plan_.may_run_out_of_slots)
      return "the publisher is stuck";
    if (peek(world, publisher_region, pe + offsetof(abi::PublisherEndpoint, intent_op)) !=
        abi::intent_idle) {
      return "the intent stays open after the operation";
    }
    std::uint64_t justified = 0;
    for (std::uint64_t q = first + 1; q <= own.core.head_sequence(); ++q) {
      bool keep = plan_.transient_local && !plan_.publisher_leaves &&
                  q + plan_.depth > own.core.head_sequence();
      for (std::uint32_t s = 0; s < 2; ++s) {
        if (plan_.sub[s].hangs && state.sub_dead[s] == 0 && !is_withdrawn(state, s))
          keep = keep || q + plan_.sub[s].depth > own.core.head_sequence();
        for (std::uint64_t i = 0; i < state.held_count[s]; ++i)
          keep = keep || state.held[s][i].sequence == q;
      }
      justified += keep;
      if (keep && (state.freed >> (q - first) & 1) != 0) return "history or a held message is gone";
    }
    std::uint64_t live = 0;
    for (std::uint64_t i = 0; i < plan_.slots; ++i)
      live += peek(world, publisher_region, pe + abi::slot_offset(plan_.ring, i)) != 0;
    if (live != own.core.allocated_count())
      return "slots in memory and the publisher's own account differ";
    if (own.core.allocated_count() != justified)
      return "leak: a message nobody can ask for stays allocated";
  } else {
    if (peek(world, publisher_region, pe + offsetof(abi::PublisherEndpoint, intent_op)) !=
        abi::intent_idle) {
      return "recovery left the intent open";
    }
    for (std::uint64_t i = 0; i < plan_.slots; ++i) {
      const std::uint64_t id = peek(world, publisher_region, pe + abi::slot_offset(plan_.ring, i));
      if ((id & ~abi::retired_mark) > head)
        return "recovery left a slot of a message that was never committed";
    }
    for (std::uint64_t i = 0; i < plan_.ring; ++i) {
      if (abi::sequence_of(peek(world, publisher_region, pe + abi::order_offset(i))) > head) {
        return "recovery left a ring entry of a message that was never committed";
      }
    }
  }
  return nullptr;
}

}  // namespace agnocast::model
