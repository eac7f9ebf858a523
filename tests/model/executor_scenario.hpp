// SPDX-License-Identifier: Apache-2.0
//
// Executor scenario: threads of one or two executors serve mutually exclusive callback groups that
// share a wait set; a publisher commits messages to all of them and rings. A thread may stop (an
// exception of its callback), its callback may never end, and a message may be lost (its depth)
// when its callback has begun already.
//
// The executors' code works under mutexes, so a step here is one critical section of ExecutorCore,
// GroupCallbacks or WaitSet, or a publisher's access to the sleep word; the scan of the groups
// before a sleep is one step for each group, because they become free meanwhile. The scenario
// restates client/executors/executor_core.cpp: a change there is a change here.
// Checked when no move is left: every message was taken, but for those of a group whose callback
// never ends.
#pragma once

#include <tests/model/explorer.hpp>

#include <cstdint>
#include <cstring>
#include <utility>

namespace agnocast::model {

/// A statement that is left out, to see that it is needed.
enum class ExecutorFault : std::uint8_t {
  none,
  nobody_takes_over,      // a thread that begins a callback does not let another one look
  waits_after_nothing,    // a thread whose callback had nothing to do does not look again
  stops_silently,         // a thread stops without waking another one
  same_value_armed,       // a second sleeping thread does not change the sleep word
  first_disarms_for_all,  // the first thread that wakes disarms
};

struct ExecutorPlan {
  const char* name = "";
  std::uint64_t threads = 2;
  std::uint64_t core_of_thread[4] = {};
  std::uint64_t groups = 2;
  std::uint64_t core_of_group[3] = {};
  std::uint64_t messages = 2;  // of each group
  bool first_stops = false;
  bool first_never_ends = false;  // the callback of the second group, in the first thread
  ExecutorFault fault = ExecutorFault::none;
};

class ExecutorScenario {
 public:
  static constexpr std::uint8_t thread_count = 5;  // four of executors, the publisher
  static constexpr std::uint8_t publisher = 4;
  static constexpr std::size_t word_count = 1;  // none of it is modelled memory
  enum Pc : std::uint64_t {
    look = 0,
    run_callback,
    end_callback,
    stop,
    gone,
    begin_wait,
    scan_groups,
    asleep,
    wake_up,
    successor,
    commit,
    ring
  };
  struct State {
    std::uint64_t pc[thread_count] = {};
    std::uint64_t group[thread_count] = {};  // what it runs, or scans next
    std::uint64_t had_nothing[4] = {};       // its callback
    std::uint64_t unpublished[3] = {};
    std::uint64_t unread[3] = {};
    std::uint64_t busy[3] = {};
    // of each core
    std::uint64_t locked[2] = {};
    std::uint64_t is_watched[2] = {};
    std::uint64_t edge[2] = {};  // its epoll set has something
    // of the wait set
    std::uint64_t armed_threads = 0;
    std::uint64_t armed = 0;
    std::uint64_t rung = 0;  // this value of the sleep word
  };
  using W = World<ExecutorScenario>;

  explicit ExecutorScenario(const ExecutorPlan& plan) : plan_(plan) {}

  W start() const {
    W world;
    for (std::uint64_t t = plan_.threads; t < publisher; ++t) world.state.pc[t] = gone;
    world.state.pc[publisher] = commit;
    for (std::uint64_t g = 0; g < plan_.groups; ++g) world.state.unpublished[g] = plan_.messages;
    return world;
  }

  static const char* thread_name(std::uint8_t t) {
    static constexpr const char* names[] = {"first", "second", "third", "fourth", "publisher"};
    return names[t];
  }
  const char* operation_name(const W&, std::uint8_t) const { return ""; }
  const char* describe(std::uint8_t, std::uint16_t argument) const {
    static constexpr const char* names[] = {
        "look",        "callback", "end of callback", "note freed", "stop",      "gone",   "wait",
        "check freed", "scan",     "asleep",          "wake up",    "successor", "commit", "ring"};
    return names[argument / 4];
  }
  bool runnable(const W&, std::uint8_t) const { return false; }
  void run(W&, std::uint8_t) {}
  void quiet(const W&, std::uint8_t, std::uint8_t* words) const {
    std::memset(words, 0, word_count);
  }

  /// The argument: what the thread does, and with which group.
  template <class Emit>
  void moves(const W& world, Emit emit) const {
    const State& state = world.state;
    for (std::uint8_t t = 0; t < thread_count; ++t) {
      const auto move = [&](std::uint64_t group = 0) {
        emit(t, static_cast<std::uint16_t>(state.pc[t] * 4 + group));
      };
      const bool is_locked = t != publisher && state.locked[core(t)] != 0;
      switch (state.pc[t]) {
        case gone:
        case successor:
          break;
        case run_callback:
          if (plan_.first_never_ends && t == 0 && state.group[t] == 1) break;
          move();
          move(1);
          break;
        case look:
          if (is_locked) break;
          if (!has_work(state, core(t))) move(3);
          for (std::uint64_t g = 0; g < plan_.groups; ++g) {
            if (is_ready(state, core(t), g)) move(g);
          }
          break;
        case commit:
          for (std::uint64_t g = 0; g < plan_.groups; ++g) {
            if (state.unpublished[g] != 0) move(g);
          }
          break;
        case asleep:
          if (state.edge[core(t)] != 0) move();
          break;
        case stop:
        case begin_wait:
        case wake_up:
          if (!is_locked) move();
          break;
        default:
          move();
      }
    }
  }

  bool perform(W& world, std::uint8_t t, std::uint16_t argument) const {
    State& state = world.state;
    const std::uint64_t group = argument % 4;
    const std::uint64_t c = t != publisher ? core(t) : 0;
    std::uint64_t& pc = state.pc[t];
    switch (pc) {
      case look:
        pc = begin_wait;
        if (group != 3) begin(state, t, group);
        break;
      case run_callback:
        --state.unread[state.group[t]];
        state.had_nothing[t] = group;
        pc = end_callback;
        break;
      case end_callback: {
        const std::uint64_t of = std::exchange(state.group[t], 0);
        state.busy[of] = 0;
        const bool stops = plan_.first_stops && t == 0;
        pc = stops ? stop : next_of(state, t);
        break;
      }
      case stop:
        pc = gone;
        if (plan_.fault == ExecutorFault::stops_silently) break;
        while (wake_successor(state, c)) {
        }
        state.edge[c] = 1;
        break;
      case begin_wait:
        wait(state, t);
        break;
      case scan_groups:
        scan(state, t);
        break;
      case asleep:
        state.edge[c] = 0;
        pc = wake_up;
        break;
      case wake_up:
        disarm(state);
        state.is_watched[c] = 0;
        pc = look;
        break;
      case commit:
        --state.unpublished[group];
        ++state.unread[group];
        pc = ring;
        break;
      case ring:
        if (state.armed != 0 && state.rung == 0) {
          state.rung = 1;
          state.edge[0] = state.edge[1] = 1;
        }
        pc = commit;
        break;
      default:
        break;
    }
    return true;
  }

  const char* finished(const W& world) const {
    for (std::uint64_t g = 0; g < plan_.groups; ++g) {
      if (world.state.busy[g] == 0 && world.state.unread[g] + world.state.unpublished[g] != 0)
        return "a message waits while all threads sleep";
    }
    return nullptr;
  }

 private:
  std::uint64_t core(std::uint8_t t) const { return plan_.core_of_thread[t]; }
  bool is_ready(const State& state, std::uint64_t core, std::uint64_t group) const {
    return plan_.core_of_group[group] == core && state.busy[group] == 0 && state.unread[group] != 0;
  }
  bool has_work(const State& state, std::uint64_t core) const {
    for (std::uint64_t g = 0; g < plan_.groups; ++g) {
      if (is_ready(state, core, g)) return true;
    }
    return false;
  }
  std::uint64_t next_of(State& state, std::uint8_t t) const {
    const bool waits = std::exchange(state.had_nothing[t], 0) != 0 &&
                       plan_.fault == ExecutorFault::waits_after_nothing;
    return waits ? begin_wait : look;
  }
  bool wake_successor(State& state, std::uint64_t of) const {
    for (std::uint8_t t = 0; t < plan_.threads; ++t) {
      if (state.pc[t] != successor || core(t) != of) continue;
      state.pc[t] = look;
      return true;
    }
    return false;
  }
  void disarm(State& state) const {
    --state.armed_threads;
    if (state.armed_threads == 0 || plan_.fault == ExecutorFault::first_disarms_for_all)
      state.armed = 0;
  }

  void begin(State& state, std::uint8_t t, std::uint64_t group) const {
    state.busy[group] = 1;
    state.group[t] = group;
    state.pc[t] = run_callback;
    if (state.is_watched[core(t)] == 0 && plan_.fault != ExecutorFault::nobody_takes_over)
      wake_successor(state, core(t));
  }

  void wait(State& state, std::uint8_t t) const {
    const std::uint64_t c = core(t);
    if (state.is_watched[c] != 0) {
      state.pc[t] = successor;
      return;
    }
    ++state.armed_threads;
    if (plan_.fault != ExecutorFault::same_value_armed || state.armed == 0) state.rung = 0;
    state.armed = 1;
    state.locked[c] = 1;
    state.group[t] = 0;
    state.pc[t] = scan_groups;
  }

  void scan(State& state, std::uint8_t t) const {
    const std::uint64_t c = core(t);
    if (state.group[t] < plan_.groups && !is_ready(state, c, state.group[t])) {
      ++state.group[t];
      return;
    }
    const bool found = state.group[t] < plan_.groups;
    state.group[t] = 0;
    state.locked[c] = 0;
    if (found) disarm(state);
    state.is_watched[c] = !found;
    state.pc[t] = found ? look : asleep;
  }

  const ExecutorPlan plan_;
};

}  // namespace agnocast::model
