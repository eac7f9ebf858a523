// SPDX-License-Identifier: Apache-2.0
//
// Isolation scenario: a CallbackIsolatedExecutor begins to spin, ends and begins again while an
// endpoint of one of its groups is created, which gives the group a wait set that its core, idle
// or isolated, then listens to. Listening may fail once; the creation is then repeated with
// another wait set. A publisher rings the endpoint.
//
// Steps are critical sections, as in executor_scenario.hpp, which has the details of a sleep. This
// one restates callback_groups::of_endpoint, IsolatedGroups and ExecutorCore::adopt and listen.
// Checked when no move is left, while the executor spins: every message was taken.
#pragma once

#include <tests/model/explorer.hpp>

#include <cstdint>
#include <cstring>

namespace agnocast::model {

/// A statement that is left out, to see that it is needed.
enum class IsolationFault : std::uint8_t {
  none,
  listens_first,     // the group has its wait set after its core listens to it
  adopts_deaf,       // a core does not listen to the wait set that the group brings
  listens_silently,  // a core that listens to a new wait set does not wake its thread
  keeps_former,      // a core that listens to another wait set already does not change that
};

struct IsolationPlan {
  const char* name = "";
  bool first_listening_fails = false;
  IsolationFault fault = IsolationFault::none;
};

class IsolationScenario {
 public:
  static constexpr std::uint8_t thread_count = 4;
  static constexpr std::size_t word_count = 1;  // none of it is modelled memory
  enum Who : std::uint8_t { creator, executor, isolated, publisher };
  enum Pc : std::uint64_t {
    // clang-format off
    gone, set_wait_set, listen, unset, begin, adopt, cancel, join, look, fall_asleep, asleep,
    commit, ring
    // clang-format on
  };
  struct State {
    std::uint64_t pc[thread_count] = {set_wait_set, begin, gone, gone};
    std::uint64_t is_locked = 0;  // IsolatedGroups, from `begin` to `adopt`
    std::uint64_t times_begun = 0, is_cancelled = 0;
    std::uint64_t wait_set = 0, creation = 1;  // the group's; the one that is being given to it
    std::uint64_t listened = 0;                // by the core that has the group
    std::uint64_t unpublished = 2, unread = 0;
    std::uint64_t armed = 0, edge = 0;  // wait set; the thread's epoll set has something
  };
  using W = World<IsolationScenario>;

  explicit IsolationScenario(const IsolationPlan& plan) : plan_(plan) {}
  W start() const {
    W world;
    if (is(IsolationFault::listens_first)) world.state.pc[creator] = listen;
    return world;
  }

  static const char* thread_name(std::uint8_t t) {
    static constexpr const char* names[] = {"creator", "executor", "isolated", "publisher"};
    return names[t];
  }
  const char* operation_name(const W&, std::uint8_t) const { return ""; }
  const char* describe(std::uint8_t, std::uint16_t argument) const {
    static constexpr const char* names[] = {"",        "set",    "listen", "unset", "begin",
                                            "adopt",   "end",    "joined", "look",  "fall asleep",
                                            "wake up", "commit", "ring"};
    return names[argument];
  }
  bool runnable(const W&, std::uint8_t) const { return false; }
  void run(W&, std::uint8_t) {}
  void quiet(const W&, std::uint8_t, std::uint8_t* words) const {
    std::memset(words, 0, word_count);
  }

  template <class Emit>
  void moves(const W& world, Emit emit) const {
    const State& s = world.state;
    for (std::uint8_t t = 0; t < thread_count; ++t) {
      const std::uint64_t pc = s.pc[t];
      if (pc == gone || (pc == asleep && s.edge == 0) || (pc == listen && s.is_locked != 0))
        continue;
      if (pc != join || s.pc[isolated] == gone) emit(t, static_cast<std::uint16_t>(pc));
    }
  }

  bool perform(W& world, std::uint8_t t, std::uint16_t) const {
    State& s = world.state;
    std::uint64_t& pc = s.pc[t];
    const std::uint64_t was = pc;
    if (was == set_wait_set) {
      s.wait_set = s.creation;
      pc = is(IsolationFault::listens_first) ? created(s) : listen;
    } else if (was == listen) {
      pc = do_listen(s) ? (is(IsolationFault::listens_first) ? set_wait_set : created(s)) : unset;
    } else if (was == unset) {
      s.wait_set = 0;
      s.creation = 2;
      pc = set_wait_set;
    } else if (was == begin) {  // the idle core drops the group
      s.is_locked = 1;
      s.listened = 0;
      pc = adopt;
    } else if (was == adopt) {  // a new core, with a thread
      s.is_locked = s.is_cancelled = s.edge = 0;
      if (!is(IsolationFault::adopts_deaf)) s.listened = s.wait_set;
      s.pc[isolated] = look;
      pc = ++s.times_begun == 2 ? gone : cancel;
    } else if (was == cancel) {
      s.is_cancelled = s.edge = 1;
      pc = join;
    } else if (was == join) {  // the idle core gets the group back
      s.listened = s.wait_set;
      pc = begin;
    } else if (was == look) {
      pc = s.is_cancelled != 0 ? gone : s.unread != 0 ? look : fall_asleep;
      if (pc == look) --s.unread;
    } else if (was == fall_asleep) {
      pc = s.unread != 0 ? look : asleep;
      if (pc == asleep) s.armed = s.listened;
    } else if (was == asleep) {
      s.edge = s.armed = 0;
      pc = look;
    } else if (was == commit) {
      --s.unpublished;
      ++s.unread;
      pc = ring;
    } else {  // the wait set that the endpoint has announced
      if (s.armed == s.creation) s.edge = 1;
      pc = s.unpublished != 0 ? commit : gone;
    }
    return true;
  }

  const char* finished(const W& world) const {
    return world.state.unread != 0 ? "a message waits while the group's thread sleeps" : nullptr;
  }

 private:
  bool is(IsolationFault fault) const { return plan_.fault == fault; }
  static std::uint64_t created(State& s) {
    s.pc[publisher] = commit;
    return gone;
  }
  bool do_listen(State& s) const {
    if (s.listened == s.creation || (s.listened != 0 && is(IsolationFault::keeps_former)))
      return true;
    if (plan_.first_listening_fails && s.creation == 1) return false;
    s.listened = s.creation;
    if (!is(IsolationFault::listens_silently)) s.edge = 1;
    return true;
  }

  const IsolationPlan plan_;
};

}  // namespace agnocast::model
