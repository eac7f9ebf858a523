// SPDX-License-Identifier: Apache-2.0
//
// Departure: an endpoint's progress in leaving. Its owner requests it, at any time. The control
// thread reports it once (the connection repeats unanswered requests). Then the daemon knows.
#pragma once

#include <atomic>

namespace agnocast {

class Departure {
 public:
  // --- any thread
  void want() noexcept { wanted_.store(true, std::memory_order_release); }
  /// Returns whether the daemon knows: its peers then ignore the endpoint.
  bool is_known() const noexcept { return known_.load(std::memory_order_acquire); }

  // --- control thread
  bool is_wanted() const noexcept { return wanted_.load(std::memory_order_acquire); }
  void known() noexcept { known_.store(true, std::memory_order_release); }
  /// The answer was not the daemon's but a refusal in an orphaned session: report it again.
  void forgotten() noexcept {
    known_.store(false, std::memory_order_release);
    is_reported_ = false;
  }
  /// Returns whether it has to be reported now.
  bool is_due() const noexcept { return is_wanted() && !is_known() && !is_reported_; }
  /// Marks the report as handed to the connection.
  void reported() noexcept { is_reported_ = true; }

 private:
  std::atomic<bool> wanted_{false}, known_{false};
  bool is_reported_ = false;
};

}  // namespace agnocast
