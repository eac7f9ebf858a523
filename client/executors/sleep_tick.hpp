// SPDX-License-Identifier: Apache-2.0
//
// SleepTick: ends every sleep after a second.
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
  static constexpr std::chrono::seconds period{1};

  /// Ends a wait on `epoll` once a period as long as it lives, if wind_up() follows each report
  /// of `tag`. Errors: os_failure.
  [[nodiscard]] static Result<SleepTick> in(int epoll, std::uint64_t tag) {
    UniqueFd timer = keep(UniqueFd(::timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK)));
    const itimerspec every{{period.count(), 0}, {period.count(), 0}};
    epoll_event event{};
    event.events = EPOLLIN;
    event.data.u64 = tag;
    if (!timer || ::timerfd_settime(timer.get(), 0, &every, nullptr) != 0 ||
        ::epoll_ctl(epoll, EPOLL_CTL_ADD, timer.get(), &event) != 0)
      return fail(Errc::os_failure, "preparing the tick of a sleep", errno);
    return SleepTick(std::move(timer));
  }
  void wind_up() const noexcept {
    if (!may_use(timer_.get())) return;
    std::uint64_t ticks = 0;
    [[maybe_unused]] const ssize_t got = ::read(timer_.get(), &ticks, sizeof ticks);
  }

 private:
  explicit SleepTick(UniqueFd timer) noexcept : timer_(std::move(timer)) {}
  UniqueFd timer_;
};

}  // namespace agnocast
