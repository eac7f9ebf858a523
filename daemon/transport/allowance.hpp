// SPDX-License-Identifier: Apache-2.0
//
// Allowance: how often something may be done, so many times at once and so often in the long run.
// Pure; time is told.
//
// Each time costs an interval of credit; who is more than `at_once` intervals ahead has to wait.
#pragma once

#include <algorithm>
#include <cstdint>

namespace agnocast::daemon {

class Allowance {
 public:
  constexpr Allowance(std::uint64_t at_once, std::uint64_t interval_ms) noexcept
      : at_once_(at_once), interval_ms_(interval_ms) {}

  /// How long it takes until the next time is allowed; 0: it is.
  std::uint64_t due_ms(std::uint64_t now_ms) const noexcept {
    const std::uint64_t ahead = std::max(paid_until_ms_, now_ms) - now_ms;
    return ahead < at_once_ * interval_ms_ ? 0 : ahead - at_once_ * interval_ms_ + 1;
  }
  /// How many were taken that are not paid off yet.
  std::uint64_t ahead(std::uint64_t now_ms) const noexcept {
    if (interval_ms_ == 0) return 0;
    return (std::max(paid_until_ms_, now_ms) - now_ms + interval_ms_ - 1) / interval_ms_;
  }
  /// Nothing was taken for so long that it is as if nothing ever was.
  bool is_whole(std::uint64_t now_ms) const noexcept { return paid_until_ms_ <= now_ms; }
  /// False: not now; nothing is taken.
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
