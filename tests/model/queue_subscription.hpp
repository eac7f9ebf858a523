// SPDX-License-Identifier: Apache-2.0
//
// QueueScenario: subscriptions, their common executor, the releasing thread, and what
// subscriptions may see.
#pragma once

#include <tests/model/queue_scenario.hpp>

namespace agnocast::model {

// Long because each operation of a subscription is one branch, as the explorer interleaves them.
inline void QueueScenario::run_subscription(W& world, std::uint32_t s) {
  alignas(8) unsigned char scratch[sizeof(SubscriptionPrivate)];
  std::memcpy(scratch, world.state.sub[s], sizeof scratch);
  auto& own = *std::launder(reinterpret_cast<SubscriptionPrivate*>(scratch));
  Thread& thread = world.threads[sub0 + s];
  State& state = world.state;
  const SubscriptionPlan& plan = plan_.sub[s];
  switch (thread.pc) {
    case join:
      state.join_head[s] = abi::sequence_of(peek(world, publisher_region, pe));
      state.request[s] = joining;
      state.joined[s] = 0;
      thread.pc = await_join;
      break;
    case await_join:
      thread.pc = state.joined[s] == 1
                      ? link_up
                      : left;  // no publisher was announced: late joiners do not link to orphans
      state.joined[s] = 0;
      break;
    case link_up: {
      const bool from_start = !plan.late;
      if (!own.link.link(from_start)) {
        machine.fail("the announced publisher is not on the board");
        break;
      }
      check_start(world, s, own.link.cursor(), from_start);
      state.answer_head[s] = 0;
      own.last = own.link.cursor() - 1;
      thread.pc = plan.hangs ? hung : take;
      if (plan_.one_executor && s == 1) {
        thread.pc = served;
        if (plan_.fault != QueueFault::links_without_waking) state.doorbell[0] = 1;
      }
      if (is_to_be_replaced(world, s)) thread.pc = sleep;
      break;
    }
    case take: {
      if (machine.remember(state.held_count[s]) == plan.quota) {
        thread.pc = release_one;
        break;
      }
      if (is_to_be_replaced(world, s) || (plan.leaves && machine.choose(2) == 1)) {
        thread.pc = leave;
        break;
      }
      if (!plan.other_thread_releases && machine.remember(state.held_count[s]) != 0 &&
          machine.choose(2) == 1) {
        thread.pc = release_one;
        break;
      }
      run_take(world, s, own, thread);
      break;
    }
    case release_one:
      if (!plan.other_thread_releases) release_oldest(world, s, own);
      thread.pc = take;
      break;
    case sleep:
      own.sleep.arm();
      own.link.observe_publisher();
      if (own.link.drained()) {
        own.sleep.disarm();
        thread.pc = drain_holds;
      } else if (M_holds(steps::S3_news, own.link.has_news()) && !awaits_window(world, s, own)) {
        own.sleep.disarm();
        thread.pc = take;
      } else {
        thread.pc = blocked;
      }
      break;
    case blocked:
      if (machine.live) state.doorbell[s] = 0;
      own.sleep.disarm();
      thread.pc = take;
      if (is_to_be_replaced(world, s) && ++own.wakes < 2) thread.pc = sleep;
      break;
    case leave:
      state.request[s] = leaving;
      state.joined[s] = 0;
      thread.pc = await_leave;
      break;
    case await_leave:
      state.joined[s] = 0;
      thread.pc = drain_holds;
      break;
    case drain_holds:
      if (machine.remember(state.held_count[s]) == 0) {
        thread.pc = unlink_line;
      } else {
        release_oldest(world, s, own);
      }
      break;
    case unlink_line:
      own.link.unlink();
      thread.pc = left;
      if (own.link.drained()) {
        if (own.link.cursor() <= abi::sequence_of(peek(world, publisher_region, pe)) &&
            state.withdrawal[s] < 2) {
          machine.fail("what a publisher that is gone had committed was not delivered");
        }
        state.request[s] = unlinked;
      } else {
        state.request[s] = drained;
        if ((plan.rejoins || plan.rejoin_depth != 0) && state.generation[s] == 1) thread.pc = join;
        if (plan.rejoin_depth != 0 && state.generation[s] == 1)
          become_another_process(world, s, own);
      }
      break;
    default:
      break;
  }
  std::memcpy(state.sub[s], scratch, sizeof scratch);
}

inline void QueueScenario::run_executor(W& world) {
  alignas(8) unsigned char scratch[2][sizeof(SubscriptionPrivate)];
  std::memcpy(scratch, world.state.sub, sizeof scratch);
  const auto own = [&](std::uint32_t s) -> SubscriptionPrivate& {
    return *std::launder(reinterpret_cast<SubscriptionPrivate*>(scratch[s]));
  };
  Thread& thread = world.threads[sub0];
  const auto second = [&] { return machine.remember(world.threads[sub1].pc == served) != 0; };
  const std::uint32_t s = thread.pc == take_other ? 1 : 0;
  switch (thread.pc) {
    case take:
    case take_other:
      if (machine.remember(world.state.held_count[s]) != 0) {
        release_oldest(world, s, own(s));
        break;
      }
      run_take(world, s, own(s), thread);
      if (s == 0 && thread.pc == sleep && second()) thread.pc = take_other;
      break;
    case sleep: {
      own(0).sleep.arm();
      bool news = plan_.fault != QueueFault::looks_at_last_link && own(0).link.has_news();
      if (!news && second()) news = own(1).link.has_news();
      news = M_holds(steps::S3_news, news);
      if (news) own(0).sleep.disarm();
      thread.pc = news ? take : blocked;
      break;
    }
    default:
      if (machine.live) world.state.doorbell[0] = 0;
      own(0).sleep.disarm();
      thread.pc = take;
      break;
  }
  // The second subscription belongs to another thread until it is linked.
  std::memcpy(world.state.sub[0], scratch[0], sizeof scratch[0]);
  if (s == 1) std::memcpy(world.state.sub[1], scratch[1], sizeof scratch[1]);
}

inline void QueueScenario::start_linked(W& world, std::uint32_t s) {
  const std::uint32_t region = static_cast<std::uint32_t>(client_region(s).id);
  const SubscriptionPrivate& own = sub_private(world, s);
  poke(world, region, line_offset(s), generation);
  poke(world, region, line_offset(s) + 8, own.link.cursor());
  sub_private(world, s).last = own.link.cursor() - 1;
  struct {
    void ring(std::uint64_t, std::uint64_t) {}
  } nobody_sleeps_yet;
  publisher_private(world).core.attach(s, 1, client_region(s), extent(s), armed_offset(),
                                       executor(s), nobody_sleeps_yet);
  world.threads[sub0 + s].pc = plan_.one_executor && s == 1 ? served : take;
}

inline void QueueScenario::run_take(W& world, std::uint32_t s, SubscriptionPrivate& own,
                                    Thread& thread) {
  State& state = world.state;
  const SubscriptionPlan& plan = plan_.sub[s];
  const abi::Qos qos = requested(s, state.generation[s]);
  const std::uint64_t from = own.link.cursor();
  const std::uint64_t head_before =
      machine.remember(abi::sequence_of(peek(world, publisher_region, pe)));
  own.windows_seen = machine.remember(windows_of(world, s));
  ModelWindows windows{world, own.opened, own.windows_seen, plan.cannot_map, plan_.second_is_fresh};
  const auto taken = own.link.take(windows);
  const std::uint64_t head = abi::sequence_of(peek(world, publisher_region, pe));
  const std::uint64_t to = taken ? taken->sequence : own.link.cursor();
  if (own.link.malformed() != 0) machine.fail("an honest publisher looks malformed");
  for (std::uint64_t q = from; q < to; ++q) {
    if (head < q + qos.depth && !may_be_unreachable(world, s, q - first) && state.withdrawal[s] < 2)
      machine.fail("a message was lost with fewer than D newer ones");
    if (plan.keep_all && plan_.keep_all && state.withdrawal[s] < 2)
      machine.fail("keep-all lost a message");
  }
  if (!taken) {
    thread.pc = machine.remember(state.held_count[s]) != 0 && !plan.sleep_holding &&
                        !plan.other_thread_releases
                    ? release_one
                    : sleep;
    return;
  }
  if (taken->sequence <= own.last) machine.fail("a message came twice or out of order");
  if (taken->sequence + abi::reach_of(qos) <= head_before)
    machine.fail("a message outside the own depth was delivered");
  own.last = taken->sequence;
  const std::uint64_t number = taken->sequence - first;
  if (taken->address != address_of(number) || taken->size != 16 || taken->stamp_ns != number)
    machine.fail("the entry of another message");
  const bool second = needs_second(number);
  if (plan.cannot_map == (second ? 2u : 1u))
    machine.fail("a message that cannot be read was handed out");
  if (number < 16 && own.opened[second ? 1 : 0] < state.need_open[number])
    machine.fail("the mapping does not cover the message");
  if (number < 64 && (state.freed >> number & 1) != 0)
    machine.fail("a freed message was handed out");
  state.held[s][state.held_count[s]++] = {taken->slot, taken->sequence};
}

inline void QueueScenario::check_start(const W& world, std::uint32_t s, std::uint64_t cursor,
                                       bool from_start) {
  const State& state = world.state;
  if (from_start) {
    if (cursor != first + 1)
      machine.fail("a subscription that was there first misses the beginning");
    return;
  }
  const std::uint64_t back = plan_.transient_local && plan_.sub[s].transient_local
                                 ? std::min(plan_.depth, requested(s, state.generation[s]).depth)
                                 : 0;
  const std::uint64_t earliest =
      std::max(first + 1, state.join_head[s] + 1 - std::min(back, state.join_head[s]));
  // It misses nothing that was committed after the answer, unless so much was that its window
  // passed over it before it linked.
  const std::uint64_t latest =
      std::max(first + 1, state.answer_head[s] + 1 - std::min(back, state.answer_head[s]));
  const std::uint64_t end = abi::sequence_of(peek(world, publisher_region, pe)) + 1;
  const std::uint64_t window = abi::reach_of(requested(s, state.generation[s]));
  if (cursor > std::max(latest, end - std::min(window, end)))
    machine.fail("a late joiner misses what was committed after its join, or its history");
  if (cursor < earliest) machine.fail("a late joiner starts before it may");
}

inline void QueueScenario::release_oldest(W& world, std::uint32_t s, SubscriptionPrivate& own) {
  State& state = world.state;
  const std::uint64_t slot = machine.remember(state.held[s][0].slot);
  forget_oldest(state, s);
  own.link.release(slot);
}

inline void QueueScenario::forget_oldest(State& state, std::uint32_t s) {
  if (!machine.live) return;
  // Reading ends here; the ghost releases before the bit does.
  for (std::uint64_t i = 1; i < state.held_count[s]; ++i) state.held[s][i - 1] = state.held[s][i];
  state.held[s][--state.held_count[s]] = {};
}

inline void QueueScenario::become_another_process(W& world, std::uint32_t s,
                                                  SubscriptionPrivate& own) {
  if (!machine.live) return;
  poke(world, sub_region0 + s, armed_offset(), 0);
  own.~SubscriptionPrivate();
  new (&own) SubscriptionPrivate(link_identity(s, 2), {sub_region0 + s}, armed_offset());
}

inline void QueueScenario::run_releaser(W& world, std::uint32_t s) {
  alignas(8) unsigned char scratch[sizeof(SubscriptionPrivate)];
  std::memcpy(scratch, world.state.sub[s], sizeof scratch);
  release_oldest(world, s, *std::launder(reinterpret_cast<SubscriptionPrivate*>(scratch)));
}

}  // namespace agnocast::model
