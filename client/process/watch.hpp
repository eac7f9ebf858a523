// SPDX-License-Identifier: Apache-2.0
//
// Watch: lets threads wait for any change. A waiting thread remembers the count from before its
// check, so that it misses no change in between.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>

namespace agnocast {

class Watch {
 public:
  using Clock = std::chrono::steady_clock;

  /// Any thread; its lock is the innermost.
  void notify() noexcept {
    const std::lock_guard lock(mutex_);
    ++count_;
    changed_.notify_all();
  }
  std::uint64_t count() const noexcept {
    const std::lock_guard lock(mutex_);
    return count_;
  }
  /// Waits until the count differs from `seen`, or the time is up.
  void wait_beyond(std::uint64_t seen, Clock::time_point end) noexcept {
    std::unique_lock lock(mutex_);
    const auto has_changed = [&] { return count_ != seen; };
    if (end == Clock::time_point::max()) {
      changed_.wait(lock, has_changed);
    } else {
      changed_.wait_until(lock, end, has_changed);
    }
  }

 private:
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::uint64_t count_ = 0;
};

}  // namespace agnocast
