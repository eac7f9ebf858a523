// SPDX-License-Identifier: Apache-2.0
//
// ReapingQueue: ends of processes that take more than one turn of the loop. A process with thousands of
// endpoints takes many; the queue gives each end its turn, so that one that leaves much behind does not keep
// other processes from being told of another end.
#pragma once

#include <daemon/death/reaper.hpp>

#include <cstdint>
#include <functional>
#include <list>

namespace agnocast::daemon {

class ReapingQueue {
 public:
  // Of the ends of processes, in one turn of the loop.
  static constexpr std::uint64_t budget_ns_of_turn = 2'000'000;
  using AfterReaping = std::function<void(const Reaped&)>;

  ReapingQueue(Registry& registry, Regions& regions, Doorbells& doorbells,
               Membership& membership) noexcept
      : registry_(registry), regions_(regions), doorbells_(doorbells), membership_(membership) {}

  /// Journals the end and does a part of the work now; `then` is called when all of it is done.
  void begin(ClientIndex client, journal::DeathReason reason, AfterReaping then,
             std::uint64_t budget_ns = budget_ns_of_turn);
  /// Has `then` called after what begin() was told, if that end is not done yet. False: it is.
  bool append(ClientIndex client, AfterReaping then);
  /// Goes on with one of the ends, for a while.
  void go_on();
  bool is_empty() const noexcept { return endings_.empty(); }

 private:
  struct Ending {
    Reaping reaping;
    AfterReaping then;
  };

  Registry& registry_;
  Regions& regions_;
  Doorbells& doorbells_;
  Membership& membership_;
  std::list<Ending> endings_;  // that have begun
};

}  // namespace agnocast::daemon
