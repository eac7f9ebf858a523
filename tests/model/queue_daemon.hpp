// SPDX-License-Identifier: Apache-2.0
//
// QueueScenario, the daemon: takes a request, redoes the record, answers.
#pragma once

#include <tests/model/queue_scenario.hpp>

namespace agnocast::model {

inline void QueueScenario::take_request(W& world) {
  Thread& thread = world.threads[daemon_main];
  State& state = world.state;
  std::uint64_t waiting = 0;
  while (request_number(world, waiting).request != none) ++waiting;
  waiting = machine.remember(waiting);
  const std::uint64_t chosen = waiting > 1 ? machine.choose(waiting) : 0;
  // One store commits the redo log record; from here on the request no longer waits.
  state.journal = request_number(world, chosen);
  switch (state.journal.request) {
    case joining:
      state.linked_to[state.journal.index] =
          matches(static_cast<std::uint32_t>(state.journal.index)) && state.publisher_dead < 2 &&
          state.publisher_state == 0;
      state.generation[state.journal.index] = state.journal.generation;
      state.withdrawal[state.journal.index] =
          plan_.sub[state.journal.index].withdrawn && state.journal.generation == 1;
      state.announced[state.journal.index] =
          matches(static_cast<std::uint32_t>(state.journal.index)) && state.publisher_dead == 0
              ? state.journal.generation
              : 0;
      [[fallthrough]];
    case leaving:
    case drained:
      state.request[state.journal.index] = none;
      break;
    case unlinked:
      state.request[state.journal.index] = none;
      state.linked_to[state.journal.index] = 0;
      break;
    case publisher_leaving:
    case publisher_unlinked:
    case window_wanted:
      state.publisher_request = none;
      break;
    case death_of_subscription:
      state.sub_dead[state.journal.index] = 2;
      break;
    default:
      state.publisher_dead = 2;
      break;
  }
  thread.pc = apply;
}

inline void QueueScenario::apply_record(W& world) {
  Thread& thread = world.threads[daemon_main];
  State& state = world.state;
  const Journal record = state.journal;
  journal::BoardSteps<MM> steps(topic());
  switch (record.request) {
    case joining:
      // Before it joins: a publisher that sees it also sees its slots.
      if (plan_.slots_before != 0)
        topic()
            .publisher(0, offsetof(abi::PublisherEntry, slot_count))
            .store(plan_.slots, std::memory_order_release);
      steps.add_subscription(
          record.index, record.generation,
          {requested(static_cast<std::uint32_t>(record.index), record.generation), 0, se,
           plan_.sub[record.index].quota, 0});
      if (state.linked_to[record.index] != 0)
        journal::set_start<MM>(words(), line(static_cast<std::uint32_t>(record.index)));
      break;
    case leaving:
      steps.set_subscription(record.index, record.generation, abi::BoardState::leaving);
      break;
    case drained:
      steps.set_subscription(record.index, record.generation, abi::BoardState::free);
      break;
    case death_of_subscription:
      if (record.generation != 0)
        steps.set_subscription(record.index, record.generation, abi::BoardState::dead);
      break;
    case unlinked:
    case window_wanted:
      break;
    case publisher_leaving:
      steps.orphan_publisher(0, generation, words().head().load(std::memory_order_acquire));
      break;
    case publisher_unlinked:
      steps.free_publisher(0, generation);
      break;
    default: {
      std::uint64_t final_head = 0;
      if (journal::recover_queue(words(), plan_.slots, final_head) ==
          journal::IntentDecision::corrupt) {
        machine.fail("an honest publisher left a corrupt intent");
      }
      steps.orphan_publisher(0, generation, final_head);
      break;
    }
  }
  thread.pc = reply;
}

inline void QueueScenario::answer_record(W& world) {
  Thread& thread = world.threads[daemon_main];
  State& state = world.state;
  // A reply leaves only when the board is in memory (the socket call is a full barrier).
  machine.fence();
  const Journal record = state.journal;
  const bool publisher_alive = state.publisher_dead == 0;
  switch (record.request) {
    case joining:
      state.joined[record.index] = state.linked_to[record.index] != 0 ? 1 : 3;
      state.answer_head[record.index] = abi::sequence_of(peek(world, publisher_region, pe));
      // The announcement brings all existing windows.
      if (state.second_window == 2) state.window_announced[record.index] = 2;
      if (publisher_alive && matches(static_cast<std::uint32_t>(record.index)))
        state.announce[record.index] = record.generation;
      break;
    case leaving:
      state.joined[record.index] = 2;
      state.kick = publisher_alive;
      break;
    case unlinked:
      break;
    case window_wanted:
      // The announcement reaches the subscribers' sockets before the answer.
      for (std::uint32_t s = 0; s < 2; ++s) state.window_announced[s] = state.linked_to[s];
      state.second_window = 2;
      break;
    case publisher_unlinked:
      state.kick = publisher_alive;
      break;
    case publisher_leaving:
      state.publisher_state = 1;
      for (std::uint32_t s = 0; s < 2; ++s) state.doorbell[s] = 1;
      state.kick = publisher_alive;
      break;
    case drained:
    case death_of_subscription:
      state.linked_to[record.index] = 0;
      if (publisher_alive && record.generation != 0) state.forget[record.index] = record.generation;
      state.kick = publisher_alive;
      break;
    default:
      state.publisher_dead = 3;
      for (std::uint32_t s = 0; s < 2; ++s) {
        if (MM::step(steps::D3_ring)) state.doorbell[s] = 1;
        state.announced[s] = 0;
      }
      state.kick = 0;
      break;
  }
  state.journal = {};
  if (state.publisher_state == 1 && state.linked_to[0] == 0 && state.linked_to[1] == 0) {
    state.publisher_state = 2;
    state.publisher_request = publisher_unlinked;  // the daemon's own next task
  }
  thread.pc = idle;
}

inline void QueueScenario::run_daemon(W& world) {
  Thread& thread = world.threads[daemon_main];
  State& state = world.state;
  switch (thread.pc) {
    case idle:
      take_request(world);
      break;
    case down:
      // Restart: redo the record of the redo log, kick and ring all.
      thread.pc = state.journal.request != none ? std::uint64_t{apply} : std::uint64_t{idle};
      state.kick = state.publisher_dead == 0;
      for (std::uint32_t s = 0; s < 2; ++s) state.doorbell[s] = 1;
      break;
    case apply:
      apply_record(world);
      break;
    case reply:
      answer_record(world);
      break;
    default:
      break;
  }
}

}  // namespace agnocast::model
