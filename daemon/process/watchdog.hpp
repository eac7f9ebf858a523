// SPDX-License-Identifier: Apache-2.0
//
// Watchdog: tells the service manager that the loop runs, if it asks (WatchdogSec=).
//
// Only the loop itself reports, between two waits: while a handler hangs there is no report, and
// the manager ends this process and starts the next one. The loop wakes up for it twice in an
// interval, and not at all when no manager asks.
#pragma once

#include <cstdint>

namespace agnocast::daemon {

class Watchdog {
 public:
  /// Reads the manager's request (WATCHDOG_USEC, WATCHDOG_PID).
  Watchdog() noexcept;

  /// Returns how many ms the loop may wait if it wants to wait `timeout_ms` (-1: for ever).
  int sooner(int timeout_ms) const noexcept;
  /// Call in every iteration of the loop; reports when it is time.
  void tick() noexcept;

 private:
  std::uint64_t period_ms_ = 0;  // 0: no manager asks
  std::uint64_t due_ms_ = 0;
};

}  // namespace agnocast::daemon
