// SPDX-License-Identifier: Apache-2.0
//
// QueueScenario: the publisher, its control thread, and the bound of keep-all.
#pragma once

#include <tests/model/queue_scenario.hpp>

namespace agnocast::model {

// Long because each operation of a publisher is one branch, as the explorer interleaves them.
inline void QueueScenario::run_publisher(W& world, std::uint8_t t) {
  // Private state is committed when the operation is complete; until then every run starts from
  // the same copy.
  alignas(8) unsigned char scratch[sizeof(PublisherPrivate)];
  std::memcpy(scratch, world.state.publisher, sizeof scratch);
  auto& own = *std::launder(reinterpret_cast<PublisherPrivate*>(scratch));
  PublisherEnvironment environment{world};
  Thread& thread = world.threads[t];
  State& state = world.state;
  if (t == publisher_control) {
    std::uint64_t due[2] = {};
    for (std::uint32_t s = 0; s < 2; ++s) {
      const bool is_due = machine.remember(withdrawal_is_due(world, s)) != 0;
      due[s] = is_due ? machine.remember(state.withdrawal[s]) : 0;
      const bool withheld = plan_.sub[s].unmapped && !(due[s] == 2 && plan_.sub[s].served_again);
      const std::uint64_t mapped = withheld ? 0 : machine.remember(state.announce[s]);
      const std::uint64_t unmapped = machine.remember(state.forget[s]);
      if (machine.live && !withheld) state.announce[s] = 0;
      if (machine.live) state.forget[s] = 0;
      if (mapped != 0 && unmapped != mapped)
        own.core.attach(s, mapped, client_region(s), extent(s), armed_offset(), executor(s),
                        environment);
      if (mapped != 0 && machine.live) state.rung[executor(s)] = 0;
      if (unmapped != 0) own.core.detach(s, unmapped);
      if (unmapped != 0 && machine.live && state.announced[s] == unmapped)
        state.announced[s] = 0;  // UNLINKED
    }
    if (machine.live) state.kick = 0;
    own.core.scan(environment);
    for (std::uint32_t s = 0; s < 2; ++s) change_withdrawal(world, own, s, due[s], environment);
    std::memcpy(state.publisher, scratch, sizeof scratch);
    return;
  }
  if (thread.pc == leave_topic) {
    machine.fence();  // the request is a system call
    state.publisher_request = publisher_leaving;
    thread.pc = finished_publishing;
    return;
  }
  if (thread.pc == timer) {
    own.core.scan(environment);
    thread.pc = own.published == plan_.messages ? finished_publishing : publish;
    std::memcpy(state.publisher, scratch, sizeof scratch);
    return;
  }
  // What others have done until here; a retry makes sense once they have done more.
  const std::uint64_t room = machine.remember(room_digest(world));
  const std::uint64_t number = own.published + 1;
  const std::uint64_t frontier =
      plan_.grow_before != 0 && number >= plan_.grow_before ? 2 * page : page;
  if (number == plan_.grow_before) dataplane::store_frontier<MM>({publisher_region}, 0, frontier);
  if (number == plan_.second_window_from) {
    if (machine.remember(state.second_window) != 2) {
      // The hook cannot allocate there before it has the window.
      state.publisher_request = window_wanted;
      state.second_window = 1;
      thread.pc = await_window;
      return;
    }
    dataplane::store_frontier<MM>({publisher_region}, 1, frontier);
  }
  if (machine.live) state.need_open[number] = frontier;
  const std::uint64_t cursor_before = machine.remember(lowest_keep_all_cursor(world));
  const auto outcome = own.core.publish({address_of(number), 16, number}, environment);
  check_bound(world, own.core.head_sequence(), cursor_before, outcome);
  if (outcome == dataplane::PublishOutcome::published) {
    ++own.published;
    state.timer_runs = 0;
    thread.pc = own.published < plan_.messages ? publish
                : plan_.publisher_leaves       ? leave_topic
                                               : finished_publishing;
    std::memcpy(state.publisher, scratch, sizeof scratch);
  } else {
    thread.pc = wait_for_room;
    std::memcpy(state.publisher, scratch, sizeof scratch);
    state.room_snapshot = room;
  }
}

inline std::uint64_t QueueScenario::lowest_keep_all_cursor(const W& world) const {
  std::uint64_t lowest = ~std::uint64_t{0};
  for (std::uint32_t s = 0; s < 2; ++s) {
    const SubscriptionPlan& plan = plan_.sub[s];
    if (!plan_.keep_all || !plan.present || plan.late || !plan.keep_all) continue;
    const std::uint64_t told = world.state.announce[s] == 0 ? peek_line(world, s, 1) : 0;
    lowest = std::min(lowest, std::max(told, first + 1));
  }
  return lowest;
}

inline void QueueScenario::check_bound(const W& world, std::uint64_t head,
                                       std::uint64_t cursor_before,
                                       dataplane::PublishOutcome outcome) const {
  if (!machine.live || cursor_before == ~std::uint64_t{0}) return;
  if (world.state.withdrawal[0] >= 2 || world.state.withdrawal[1] >= 2) return;
  std::uint64_t bound = plan_.depth;
  for (const SubscriptionPlan& plan : plan_.sub) {
    if (plan.keep_all) bound = std::min<std::uint64_t>(bound, plan.depth);
  }
  if (outcome == dataplane::PublishOutcome::published &&
      head + 1 > lowest_keep_all_cursor(world) + bound)
    machine.fail("a keep-all subscription has more unread messages than its bound");
  if (outcome == dataplane::PublishOutcome::would_block && head + 1 < cursor_before + bound)
    machine.fail("a keep-all publisher waits although there is room");
}

}  // namespace agnocast::model
