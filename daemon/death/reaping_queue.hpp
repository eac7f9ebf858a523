// SPDX-License-Identifier: Apache-2.0
//
// ReapingQueue: ends of processes that take more than one iteration of the loop, as one with
// thousands of endpoints does. The queue gives each end its time slice, so that a large one does
// not delay the notifications of another.
#pragma once

#include <daemon/death/reaper.hpp>

#include <cstdint>
#include <functional>
#include <list>

namespace agnocast::daemon {

class ReapingQueue {
 public:
  // For all ends of processes, in one iteration of the loop.
  static constexpr std::uint64_t budget_ns_of_slice = 2'000'000;
  using AfterReaping = std::function<void(const Reaped&)>;

  ReapingQueue(Registry& registry, Regions& regions, Doorbells& doorbells,
               EndpointManager& endpoint_manager) noexcept
      : registry_(registry),
        regions_(regions),
        doorbells_(doorbells),
        endpoint_manager_(endpoint_manager) {}

  /// Records the end and does a part of the work now; calls `then` when all of it is done.
  void begin(ClientIndex client, journal::DeathReason reason, AfterReaping then,
             std::uint64_t budget_ns = budget_ns_of_slice);
  /// Appends `then` to the callback of begin(). Returns false if that end is done already.
  bool append(ClientIndex client, AfterReaping then);
  /// Continues one of the ends for a while.
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
  EndpointManager& endpoint_manager_;
  std::list<Ending> endings_;  // begun and not done
};

}  // namespace agnocast::daemon
