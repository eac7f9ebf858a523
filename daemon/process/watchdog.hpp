// SPDX-License-Identifier: Apache-2.0
//
// Watchdog: tells the service manager that the loop turns, where it wants to know (WatchdogSec=).
//
// Only the loop itself speaks, between two waits: a handler that never comes back is silence, and
// the manager ends this process and starts the next one. It is woken for that twice in an interval,
// and not at all where nobody asks.
#pragma once

#include <cstdint>

namespace agnocast::daemon {

class Watchdog {
 public:
  /// What the manager asks for (WATCHDOG_USEC, WATCHDOG_PID).
  Watchdog() noexcept;

  /// How long the loop may wait, in milliseconds, if it wants to wait `timeout_ms` (-1: for ever).
  int sooner(int timeout_ms) const noexcept;
  /// To be called in every iteration of the loop; says something when it is time.
  void tick() noexcept;

 private:
  std::uint64_t period_ms_ = 0;  // 0: nobody asks
  std::uint64_t due_ms_ = 0;
};

}  // namespace agnocast::daemon
