// SPDX-License-Identifier: Apache-2.0
//
// QueueScenario: which thread may move, what a death leaves, and which loads are no scheduling
// points.
#pragma once

#include <tests/model/queue_scenario.hpp>

namespace agnocast::model {

inline bool QueueScenario::runnable(const W& world, std::uint8_t t) const {
  const State& state = world.state;
  const std::uint64_t pc = world.threads[t].pc;
  switch (t) {
    case publisher_main:
      if (state.publisher_dead != 0 || busy(world, publisher_control)) return false;
      return pc == publish || pc == timer || pc == leave_topic ||
             (pc == await_window && state.second_window == 2) ||
             (pc == wait_for_room && state.room_snapshot != room_digest(world));
    case publisher_control:
      if (state.publisher_dead != 0 || busy(world, publisher_main)) return false;
      return state.kick != 0 || has_announcement(state, 0) || has_announcement(state, 1) ||
             state.forget[0] != 0 || state.forget[1] != 0 || withdrawal_is_due(world, 0) ||
             withdrawal_is_due(world, 1);
    case sub0:
    case sub1: {
      const std::uint32_t s = t - sub0;
      if (state.sub_dead[s] != 0) return false;
      if (pc == left || pc == hung || pc == served) return false;
      if (pc == await_join) return state.joined[s] == 1 || state.joined[s] == 3;
      if (pc == await_leave) return state.joined[s] == 2;
      if (pc == blocked) return state.doorbell[s] != 0;
      if (pc == join && state.announced[s] != 0) return false;
      if (plan_.sub[s].other_thread_releases) {
        if (pc == release_one)
          return state.held_count[s] < plan_.sub[s].quota;  // waits for the other thread
        if (pc == drain_holds) return state.held_count[s] == 0;
      }
      return true;
    }
    case releaser0:
      return plan_.sub[0].other_thread_releases && state.sub_dead[0] == 0 &&
             state.held_count[0] > 0;
    case daemon_main:
      if (pc == down) return true;
      if (pc != idle) return true;
      return has_request(world);
    default:
      return false;
  }
}

inline bool QueueScenario::perform(W& world, std::uint8_t t, std::uint16_t argument) {
  State& state = world.state;
  if (argument == 1000) {
    ++state.timer_runs;
    world.threads[publisher_main].pc = timer;
    return true;
  }
  if (argument == 2000) {
    state.window_announced[t - sub0] = 2;
    state.doorbell[t - sub0] = 1;
    state.timer_runs = 0;  // a later timer run must free what it takes now
    return true;
  }
  Thread& thread = world.threads[t];
  // A SIGKILL leaves a prefix of the victim's stores; the rest was never executed.
  Machine::clear_buffer(thread, argument);
  auto stop = [&](std::uint8_t which) {
    world.threads[which].log_count = 0;
    world.threads[which].pc = down;
  };
  stop(t);
  switch (t) {
    case publisher_main:
    case publisher_control:
      stop(publisher_main);
      stop(publisher_control);
      state.publisher_dead = 1;
      ++state.publisher_deaths;
      break;
    case sub0:
    case sub1:
      state.sub_dead[t - sub0] = 1;
      if (t == sub0) stop(releaser0);
      ++state.subscriber_deaths;
      state.held_count[t - sub0] = 0;
      std::memset(static_cast<void*>(state.held[t - sub0]), 0, sizeof state.held[0]);
      break;
    default:
      ++state.daemon_deaths;
      break;
  }
  return false;
}

inline void QueueScenario::quiet(const W& world, std::uint8_t t, std::uint8_t* quiet_words) const {
  const State& state = world.state;
  for (std::size_t w = 0; w < word_count; ++w) {
    std::uint8_t is_quiet = 0;
    if (w < address_map.count) {
      switch (address_map.region_of[w]) {
        case board:
          is_quiet = t == daemon_main;
          break;
        case publisher_region:
          if (!plan_.sub[0].withdrawn && !plan_.sub[1].withdrawn &&
              w == address_map.find(publisher_region,
                                    pe + offsetof(abi::PublisherEndpoint, withdrawn))) {
            is_quiet = 1;
            break;
          }
          is_quiet =
              t == publisher_main || t == publisher_control ||
              (state.publisher_dead != 0 && world.threads[publisher_main].buffer_count == 0 &&
               world.threads[publisher_control].buffer_count == 0 &&
               (t == daemon_main || state.publisher_dead == 3));
          break;
        case sub_region0:
          is_quiet = t == sub0;
          break;
        case sub_region1:
          is_quiet = t == sub1;
          break;
        default:
          break;
      }
    }
    quiet_words[w] = is_quiet;
  }
}

}  // namespace agnocast::model
