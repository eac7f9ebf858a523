// SPDX-License-Identifier: Apache-2.0

#include <daemon/process/watchdog.hpp>

#include <base/clock.hpp>
#include <daemon/transport/descriptor_store.hpp>

#include <systemd/sd-daemon.h>

#include <algorithm>
#include <climits>

namespace agnocast::daemon {

Watchdog::Watchdog() noexcept {
  std::uint64_t interval_us = 0;
  if (::sd_watchdog_enabled(0, &interval_us) <= 0) return;
  period_ms_ = std::max<std::uint64_t>(interval_us / 2 / 1'000, 1);
  due_ms_ = monotonic_ms();
}

int Watchdog::sooner(int timeout_ms) const noexcept {
  if (period_ms_ == 0) return timeout_ms;
  const std::uint64_t now = monotonic_ms();
  const auto left =
      static_cast<int>(std::min<std::uint64_t>(due_ms_ - std::min(due_ms_, now), INT_MAX));
  return timeout_ms < 0 ? left : std::min(timeout_ms, left);
}

void Watchdog::tick() noexcept {
  if (period_ms_ == 0) return;
  const std::uint64_t now = monotonic_ms();
  if (now < due_ms_) return;
  notify("WATCHDOG=1");
  due_ms_ = now + period_ms_;
}

}  // namespace agnocast::daemon
