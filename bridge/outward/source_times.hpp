// SPDX-License-Identifier: Apache-2.0
//
// SourceTimes: the source times of one DDS writer's messages. Fast DDS gives a reader its unread
// messages in the order of these times, so each is later than the one before: the offset of
// CLOCK_REALTIME, by which they are computed, is not exact. Where the clock was really set back
// they follow it, as those of a DDS writer do. Pure.
#pragma once

#include <cstdint>

namespace agnocast::bridge {

class SourceTimes {
 public:
  /// A clock that goes back by less was not set: far more than the offset is wrong by.
  static constexpr std::int64_t inexact_max_ns = 1'000'000'000;

  /// Returns the time for the next message, in nanoseconds, as `wanted`.
  std::int64_t next(std::int64_t wanted) noexcept {
    if (wanted <= last_ && last_ - wanted < inexact_max_ns) wanted = last_ + 1;
    return last_ = wanted;
  }

 private:
  std::int64_t last_ = 0;
};

}  // namespace agnocast::bridge
