// SPDX-License-Identifier: Apache-2.0
//
// SleepTick: ends every sleep after a second, or earlier when a timer is due.
//
// A publisher that dies between commit and ring, with the daemon down as well, wakes no
// subscription. So threads that sleep on doorbells check for work from time to time. The tick is
// a timer descriptor in the epoll set; it must be read after each tick, because the kernel
// restarts it only then. A timeout of epoll_wait would set up and remove a kernel timer for each
// message, a twentieth of the time from a publisher to a wait set.
#pragma once

#include <agnocast/result.hpp>
#include <base/descriptors/kept_fd.hpp>

#include <poll.h>
#include <sys/epoll.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <utility>

namespace agnocast {

/// Pauses between two checks of a thread that has lost its descriptors, for `timeout_ms` at most
/// (-1: no limit). Returns 0.
inline int unrung_pause(int timeout_ms) noexcept {
  constexpr int pause_ms = 10;
  ::poll(nullptr, 0, timeout_ms < 0 ? pause_ms : std::min(timeout_ms, pause_ms));
  return 0;
}

class SleepTick {
 public:
  using Clock = std::chrono::steady_clock;  // the kernel's CLOCK_MONOTONIC
  static constexpr std::chrono::seconds period{1};

  /// Ends a wait on `epoll` once a period as long as it lives, if wind_up() follows each report
  /// of `tag`. Errors: os_failure.
  [[nodiscard]] static Result<SleepTick> in(int epoll, std::uint64_t tag) {
    UniqueFd timer = keep(UniqueFd(::timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK)));
    epoll_event event{};
    event.events = EPOLLIN;
    event.data.u64 = tag;
    if (!timer || !wind(timer.get(), Clock::now() + period) ||
        ::epoll_ctl(epoll, EPOLL_CTL_ADD, timer.get(), &event) != 0)
      return fail(Errc::os_failure, "preparing the tick of a sleep", errno);
    return SleepTick(std::move(timer));
  }
  /// The next tick comes at `due`, unless it comes earlier anyway.
  void tick_at(Clock::time_point due) noexcept {
    if (due == Clock::time_point::max()) return;
    const Clock::time_point now = Clock::now();
    const bool comes_before = wound_for_ > now && wound_for_ <= due;
    if (comes_before || due > now + period || !may_use(timer_.get())) return;
    if (wind(timer_.get(), due)) wound_for_ = due;
  }
  void wind_up() const noexcept {
    if (!may_use(timer_.get())) return;
    std::uint64_t ticks = 0;
    [[maybe_unused]] const ssize_t got = ::read(timer_.get(), &ticks, sizeof ticks);
  }

 private:
  explicit SleepTick(UniqueFd timer) noexcept : timer_(std::move(timer)) {}
  /// Ticks at `first`, and once a period from then on.
  static bool wind(int timer, Clock::time_point first) noexcept {
    constexpr std::int64_t second = 1'000'000'000;
    const std::int64_t ns =
        std::chrono::duration_cast<std::chrono::nanoseconds>(first.time_since_epoch()).count();
    const itimerspec ticks{{period.count(), 0}, {ns / second, ns % second}};
    return ::timerfd_settime(timer, TFD_TIMER_ABSTIME, &ticks, nullptr) == 0;
  }

  UniqueFd timer_;
  Clock::time_point wound_for_{};  // by tick_at()
};

}  // namespace agnocast
