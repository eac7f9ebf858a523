// SPDX-License-Identifier: Apache-2.0
//
// DeadlineWatch and LeaseWatch: whether somebody was silent for longer than a QoS allows (DDS 1.4,
// 2.2.3.7 and 2.2.3.11). Nobody reports messages: the caller has the time of the newest one.
// So a silence counts only if a look comes before the message that ends it; next_ns() says when to
// look. Times are nanoseconds of CLOCK_MONOTONIC; those that another process has written lie at
// most in the present.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>

namespace agnocast {

inline constexpr std::uint64_t never_ns = INT64_MAX;

/// Counts the periods that ended without a message. They begin with the first message, and anew
/// with each further one.
class DeadlineWatch {
 public:
  /// `period_ns`: 0 for none. Once, before other threads use it.
  void begin(std::uint64_t period_ns, std::uint64_t now_ns) noexcept {
    period_ns_ = period_ns;
    begin_ns_ = now_ns;
    if (period_ns != 0) wait_from(now_ns);
  }
  /// Returns how many periods have ended since the last look. `newest_ns`: when the newest message
  /// was published; 0: none is known. One thread at a time.
  std::uint64_t look(std::uint64_t now_ns, std::uint64_t newest_ns) noexcept {
    if (period_ns_ == 0) return 0;
    if (newest_ns < begin_ns_) newest_ns = 0;  // history is no sign of life
    since_ns_ = std::max(since_ns_, std::min(newest_ns, now_ns));
    const std::uint64_t missed =
        since_ns_ == 0 || now_ns < since_ns_ ? 0 : (now_ns - since_ns_) / period_ns_;
    since_ns_ += missed * period_ns_;
    wait_from(since_ns_ == 0 ? now_ns : since_ns_);
    return missed;
  }
  /// Returns when the present period ends; never_ns without a deadline. Any thread.
  std::uint64_t next_ns() const noexcept { return next_ns_.load(std::memory_order_relaxed); }

 private:
  void wait_from(std::uint64_t begin_ns) noexcept {
    next_ns_.store(std::min(begin_ns + period_ns_, never_ns), std::memory_order_relaxed);
  }

  std::uint64_t period_ns_ = 0;
  std::uint64_t begin_ns_ = 0;
  std::uint64_t since_ns_ = 0;  // begin of the present period; 0: there was no message yet
  std::atomic<std::uint64_t> next_ns_{never_ns};
};

/// Whether a publisher is alive that must show it once in each lease. At first it is. One thread at
/// a time.
class LeaseWatch {
 public:
  /// `lease_ns`: 0 for none.
  void begin(std::uint64_t lease_ns, std::uint64_t now_ns) noexcept {
    lease_ns_ = lease_ns;
    if (lease_ns != 0) look(now_ns, now_ns);
  }
  /// `shown_ns`: when it last showed that it is alive. Returns whether that has changed.
  bool look(std::uint64_t now_ns, std::uint64_t shown_ns) noexcept {
    if (lease_ns_ == 0) return false;
    shown_ns = std::min(shown_ns, now_ns);
    const bool was_alive = is_alive_;
    is_alive_ = now_ns - shown_ns <= lease_ns_;
    // Nothing announces that it is alive again: seen so often, no sign of life is too old.
    next_ns_ =
        std::min(is_alive_ ? shown_ns + 1 + lease_ns_ : now_ns + lease_ns_ / 2 + 1, never_ns);
    return is_alive_ != was_alive;
  }
  bool is_alive() const noexcept { return is_alive_; }
  /// Returns when to look next; never_ns without a lease.
  std::uint64_t next_ns() const noexcept { return next_ns_; }

 private:
  std::uint64_t lease_ns_ = 0;
  std::uint64_t next_ns_ = never_ns;
  bool is_alive_ = true;
};

}  // namespace agnocast
