// SPDX-License-Identifier: Apache-2.0
//
// Reconnection: when to try to reach the daemon again. Pure; time is told.
//
//   connected ──end──▶ waiting ──due──▶ rejoining ──▶ connected
//                         ▲───────end──────┘└──refused──▶ island (for good)
//
// The pause doubles from try to try. A connection that has lasted is what makes it short again: a
// daemon that dies of what we say does so at once, and is not asked a thousand times a second.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>

namespace agnocast {

class Reconnection {
 public:
  enum class State : std::uint8_t { connected, waiting, rejoining, island };
  using Clock = std::chrono::steady_clock;
  static constexpr std::chrono::milliseconds pause_first{1}, pause_last{250}, lasting{100};

  State state() const noexcept { return state_; }
  /// Until when to wait; only while waiting.
  Clock::time_point next_try() const noexcept { return next_try_; }
  bool is_due(Clock::time_point now) const noexcept {
    return state_ == State::waiting && now >= next_try_;
  }

  void ended(Clock::time_point now) noexcept {
    if (state_ == State::island) return;
    if (state_ == State::connected && now - since_ >= lasting) pause_ = pause_first;
    next_try_ = now + pause_;
    pause_ = std::min(pause_ * 2, pause_last);
    state_ = State::waiting;
  }
  void asked() noexcept { state_ = State::rejoining; }
  void succeeded(Clock::time_point now) noexcept {
    since_ = now;
    state_ = State::connected;
  }
  void refused() noexcept { state_ = State::island; }

 private:
  State state_ = State::connected;
  Clock::time_point since_{}, next_try_{};
  std::chrono::milliseconds pause_ = pause_first;
};

}  // namespace agnocast
