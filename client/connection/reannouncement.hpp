// SPDX-License-Identifier: Apache-2.0
//
// Reannouncement: decides when to begin a new connection, so that the daemon announces everything
// once more. Pure; the caller passes the time. There are two reasons:
//
//   - Descriptors of packets were lost, as this process had none free. It reconnects after a pause,
//     which doubles each time, and only when descriptors are free.
//   - Users have a larger share again, so endpoints that are mute or not mapped can get doorbells
//     and be mapped. It reconnects at once, but not soon after the last time.
//
//            lost(), ask()                 is_due()
//   idle ─────────────────────▶ awaited ─────────────▶ begun(), or postpone(): no descriptors
#pragma once

#include <algorithm>
#include <chrono>
#include <optional>

namespace agnocast {

class Reannouncement {
 public:
  using Clock = std::chrono::steady_clock;
  static constexpr std::chrono::seconds pause_first{1}, pause_last{30};

  /// Returns whether announcements are outstanding.
  bool is_awaited() const noexcept { return at_.has_value(); }
  bool is_due(Clock::time_point now) const noexcept { return at_ && now >= *at_; }

  /// Call when descriptors were lost.
  void lost(Clock::time_point now) noexcept {
    if (at_) return;
    pause_ = now - lost_at_ > 2 * pause_last ? pause_first : std::min(2 * pause_, pause_last);
    at_ = lost_at_ = now + pause_;
  }
  /// Returns whether it is time to check if users have a larger share again.
  bool may_look(Clock::time_point now) const noexcept {
    return !at_ && now >= looked_ + pause_first && now >= asked_ + pause_last;
  }
  void looked(Clock::time_point now) noexcept { looked_ = now; }
  /// Call when they have.
  void ask(Clock::time_point now) noexcept { at_ = asked_ = now; }

  void begun() noexcept { at_.reset(); }
  void postpone(Clock::time_point now) noexcept { at_ = now + pause_first; }

 private:
  std::optional<Clock::time_point> at_;
  Clock::time_point lost_at_{}, looked_{}, asked_{};
  std::chrono::seconds pause_{};
};

}  // namespace agnocast
