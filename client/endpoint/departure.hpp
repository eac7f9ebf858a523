// SPDX-License-Identifier: Apache-2.0
//
// Departure: how far an endpoint has come in leaving. Its owner wants it, at any time; the control
// thread says it, once (the connection repeats what was not answered); then the daemon knows.
#pragma once

#include <atomic>

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
  /// It does not: it was somebody else who refused to hear of it. To be said again.
  void forgotten() noexcept {
    known_.store(false, std::memory_order_release);
    is_reported_ = false;
  }
  /// Is it to be said now?
  bool is_due() const noexcept { return is_wanted() && !is_known() && !is_reported_; }
  /// The connection has it.
  void reported() noexcept { is_reported_ = true; }

 private:
  std::atomic<bool> wanted_{false}, known_{false};
  bool is_reported_ = false;
};

}  // namespace agnocast
