// SPDX-License-Identifier: Apache-2.0
//
// Departure: how far an endpoint has come in leaving. Its owner wants it, at any time; the control
// thread says it, once (the connection repeats what was not answered); then the daemon knows.
#pragma once

#include <atomic>
#include <utility>

namespace agnocast {

class Departure {
 public:
  // --- any thread
  void want() noexcept { wanted_.store(true, std::memory_order_release); }
  /// The daemon knows: its peers take no notice of the endpoint any more.
  bool is_known() const noexcept { return known_.load(std::memory_order_acquire); }

  // --- control thread
  bool is_wanted() const noexcept { return wanted_.load(std::memory_order_acquire); }
  void known() noexcept { known_.store(true, std::memory_order_release); }
  /// Is it to be said now? True once.
  bool is_due() noexcept { return is_wanted() && !is_known() && !std::exchange(is_said_, true); }

 private:
  std::atomic<bool> wanted_{false}, known_{false};
  bool is_said_ = false;
};

}  // namespace agnocast
