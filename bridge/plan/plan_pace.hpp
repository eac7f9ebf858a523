// SPDX-License-Identifier: Apache-2.0
//
// PlanPace: when the bridge plans for what has changed in DDS. Others decide how often something changes there, and
// a plan looks at everything: after each one there is a pause of several times its duration, so plans take a
// part of the time only, and messages go on between them. A change that comes in the pause is owed a plan.
#pragma once

#include <algorithm>
#include <chrono>
#include <optional>

namespace agnocast::bridge {

class PlanPace {
 public:
  using Time = std::chrono::steady_clock::time_point;
  /// Plans take a fifth of the time at most, and who is new waits for a second at most.
  static constexpr int pause_factor = 4;
  static constexpr std::chrono::milliseconds pause_max{1'000};

  void changed() noexcept { is_owed_ = true; }
  /// Whether something has changed since the newest plan that was made as a whole.
  bool is_owed() const noexcept { return is_owed_; }
  bool is_due(Time now) const noexcept { return is_owed_ && next_ <= now; }
  /// When it will be; nothing is owed: never.
  std::optional<Time> due() const noexcept {
    return is_owed_ ? std::optional(next_) : std::nullopt;
  }

  /// A plan was made, for all that has changed.
  void made(Time begin, Time end) noexcept {
    is_owed_ = false;
    next_ = end + std::min<Time::duration>(pause_factor * (end - begin), pause_max);
  }
  /// It cannot be made before then. What is owed stays so.
  void put_off(Time until) noexcept { next_ = until; }

 private:
  bool is_owed_ = false;
  Time next_;
};

}  // namespace agnocast::bridge
