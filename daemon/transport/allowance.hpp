// SPDX-License-Identifier: Apache-2.0
//
// Allowance: limits how often something may be done: so many times at once, and so often in the
// long run. Pure; the caller passes the time.
//
// Each use costs an interval of credit; a user more than `at_once` intervals ahead has to wait.
#pragma once

#include <algorithm>
#include <cstdint>

namespace agnocast::daemon {

class Allowance {
 public:
  constexpr Allowance(std::uint64_t at_once, std::uint64_t interval_ms) noexcept
      : at_once_(at_once), interval_ms_(interval_ms) {}

  /// Returns how long it takes until the next use is allowed; 0: it is allowed now.
  std::uint64_t due_ms(std::uint64_t now_ms) const noexcept {
    const std::uint64_t ahead = std::max(paid_until_ms_, now_ms) - now_ms;
    return ahead < at_once_ * interval_ms_ ? 0 : ahead - at_once_ * interval_ms_ + 1;
  }
  /// Returns how many uses are not paid off yet.
  std::uint64_t ahead(std::uint64_t now_ms) const noexcept {
    if (interval_ms_ == 0) return 0;
    return (std::max(paid_until_ms_, now_ms) - now_ms + interval_ms_ - 1) / interval_ms_;
  }
  /// Returns whether all uses are paid off, as if there had never been any.
  bool is_whole(std::uint64_t now_ms) const noexcept { return paid_until_ms_ <= now_ms; }
  /// Uses the allowance. Returns false if it is used up for now; nothing is taken then.
  bool take(std::uint64_t now_ms) noexcept {
    const std::uint64_t begin_ms = std::max(paid_until_ms_, now_ms);
    if (begin_ms - now_ms >= at_once_ * interval_ms_) return false;
    paid_until_ms_ = begin_ms + interval_ms_;
    return true;
  }

 private:
  std::uint64_t at_once_, interval_ms_;
  std::uint64_t paid_until_ms_ = 0;
};

}  // namespace agnocast::daemon
