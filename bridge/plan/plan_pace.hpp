// SPDX-License-Identifier: Apache-2.0
//
// PlanPace: decides when the bridge plans for changes in DDS. Other participants decide how often
// those come, and a plan reads everything: after each plan there is a pause of several times its
// duration, so plans take only a part of the time and messages move in between. A change during
// the pause is planned afterwards.
#pragma once

#include <algorithm>
#include <chrono>
#include <optional>

namespace agnocast::bridge {

class PlanPace {
 public:
  using Time = std::chrono::steady_clock::time_point;
  /// Plans take at most a fifth of the time, and a new endpoint waits at most a second.
  static constexpr int pause_factor = 4;
  static constexpr std::chrono::milliseconds pause_max{1'000};

  void changed() noexcept { is_owed_ = true; }
  /// Returns whether something has changed since the newest complete plan.
  bool is_owed() const noexcept { return is_owed_; }
  bool is_due(Time now) const noexcept { return is_owed_ && next_ <= now; }
  /// Returns when the next plan is due; nothing if none is.
  std::optional<Time> due() const noexcept {
    return is_owed_ ? std::optional(next_) : std::nullopt;
  }

  /// Call after a complete plan.
  void made(Time begin, Time end) noexcept {
    is_owed_ = false;
    next_ = end + std::min<Time::duration>(pause_factor * (end - begin), pause_max);
  }
  /// Postpones the plan. Pending changes stay pending.
  void put_off(Time until) noexcept { next_ = until; }

 private:
  bool is_owed_ = false;
  Time next_;
};

}  // namespace agnocast::bridge
