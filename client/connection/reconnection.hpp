// SPDX-License-Identifier: Apache-2.0
//
// Reconnection: decides when to try to reach the daemon again. Pure; the caller passes the time.
//
//   connected ──end──▶ waiting ──due──▶ rejoining ──▶ connected
//                         ▲───────end──────┘├──refused──▶ orphaned (for good)
//                         └──────later──────┘
//
// Some refusals end only when an administrator acts: the client asks again, seldom, and
// `is_refused` meanwhile. The pause doubles with each attempt. Only a connection that has lasted
// resets it: if a client's requests crash the daemon, they do so at once, and must not do it a
// thousand times a second.
#pragma once

#include <agnocast/error.hpp>

#include <algorithm>
#include <chrono>
#include <cstdint>

namespace agnocast {

/// Returns whether the answer changes only when an administrator installs another daemon, another
/// profile or repairs the memory. No caller waits for that.
constexpr bool is_mended_by_people(Errc code) noexcept {
  return code == Errc::layout_mismatch || code == Errc::store_damaged ||
         code == Errc::permission_denied || code == Errc::descriptors_withheld ||
         code == Errc::daemon_untrusted;
}

class Reconnection {
 public:
  enum class State : std::uint8_t { connected, waiting, rejoining, orphaned };
  using Clock = std::chrono::steady_clock;
  static constexpr std::chrono::milliseconds pause_first{1}, pause_last{250}, lasting{100},
      pause_refused{5'000};

  State state() const noexcept { return state_; }
  /// Returns the time of the next attempt; only while waiting.
  Clock::time_point next_try() const noexcept { return next_try_; }
  bool is_due(Clock::time_point now) const noexcept {
    return state_ == State::waiting && now >= next_try_;
  }

  void ended(Clock::time_point now) noexcept {
    if (state_ == State::orphaned) return;
    if (state_ == State::connected && now - since_ >= lasting) pause_ = pause_first;
    next_try_ = now + (is_refused_ ? pause_refused : pause_);
    pause_ = std::min(pause_ * 2, pause_last);
    state_ = State::waiting;
  }
  void asked() noexcept { state_ = State::rejoining; }
  void succeeded(Clock::time_point now) noexcept {
    since_ = now;
    is_refused_ = false;
    state_ = State::connected;
  }
  void refused() noexcept { state_ = State::orphaned; }
  void refused_until_mended(Clock::time_point now) noexcept {
    is_refused_ = true;
    ended(now);
  }
  bool is_refused() const noexcept { return is_refused_; }

 private:
  State state_ = State::connected;
  bool is_refused_ = false;
  Clock::time_point since_{}, next_try_{};
  std::chrono::milliseconds pause_ = pause_first;
};

}  // namespace agnocast
