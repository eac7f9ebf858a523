// SPDX-License-Identifier: Apache-2.0
//
// HeapGrowth: decides when this process's heap asks for its next window. Pure; the caller passes
// the time.
//
//                          asked                    opened
//   idle ────────────────────────────────▶ asking ─────────▶ idle, with one window more
//    ▲ permitted, wanted, not pausing          ├──refused──▶ pausing ──due──▶ idle
//    └─────────────not_asked───────────────────┤
//                                              └──exhausted──▶ asking for ever
//
// A window is requested ahead of need, because malloc never waits for the daemon, or because the
// daemon asks the heap to continue elsewhere. After a refusal (quota, arena, memory) there may be
// room again, so the request is repeated, ever more rarely: a full heap would otherwise ask in
// every cycle of the control thread. The heap of a session that begins beside another one does not
// grow before all publishers have moved: their readers have only the windows that were brought
// along.
#pragma once

#include <agnocast/abi/limits.hpp>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>

namespace agnocast {

class HeapGrowth {
 public:
  using Clock = std::chrono::steady_clock;
  static constexpr std::chrono::seconds pause_first{1}, pause_last{60};

  // --- before the control thread begins, or while growth is held back, which it then does not
  // touch

  /// Sets how many windows are brought along. None is requested before permit().
  void bring(std::uint64_t windows) noexcept { windows_ = windows; }
  void hold_back() noexcept { is_permitted_.store(false, std::memory_order_relaxed); }

  // --- any thread

  /// Returns whether it was held back until now.
  bool permit() noexcept { return !is_permitted_.exchange(true, std::memory_order_acq_rel); }

  // --- control thread

  /// Returns how many windows the daemon has announced. For a session without a daemon: any thread.
  std::uint64_t window_count() const noexcept { return windows_; }
  /// The daemon asks the heap to continue in this window.
  void move_to(std::uint64_t window) noexcept { move_to_ = window; }
  bool may_ask() const noexcept { return !is_asking_ && is_permitted_.load(); }
  /// Returns whether to ask for the next window. `wants`: the heap needs it.
  bool is_due(Clock::time_point now, bool wants) const noexcept {
    return (wants || move_to_ == windows_) && now >= again_;
  }
  void asked() noexcept { is_asking_ = true; }
  /// The request could not be made: no memory.
  void not_asked() noexcept { is_asking_ = false; }
  /// The window is in use. Returns whether it was the last possible one.
  bool opened() noexcept {
    is_asking_ = is_refused_ = false;
    pause_ = pause_first;
    return ++windows_ == abi::window_count_max;
  }
  void refused(Clock::time_point now) noexcept {
    is_asking_ = false;
    is_refused_ = true;
    again_ = now + pause_;
    pause_ = std::min(pause_ * 2, pause_last);
  }
  /// Returns whether the last request was refused.
  bool is_refused() const noexcept { return is_refused_; }

 private:
  std::uint64_t windows_ = 1;
  std::uint64_t move_to_ = 0;  // never requested: every heap begins with it
  bool is_asking_ = false, is_refused_ = false;
  std::chrono::seconds pause_ = pause_first;  // after the next refusal
  Clock::time_point again_{};                 // no request before
  std::atomic<bool> is_permitted_{true};
};

}  // namespace agnocast
