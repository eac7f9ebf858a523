// SPDX-License-Identifier: Apache-2.0
//
// ReadyCount: the number of receivers that would get a message. For systems whose sender cannot
// tell: receivers count themselves, in the scratch that all processes of a run share.
#pragma once

#include <bench/system.hpp>

#include <atomic>
#include <cstdint>

namespace agnocast::bench {

class ReadyCount {
 public:
  explicit ReadyCount(const Carriage& carriage) noexcept
      : count_(static_cast<std::atomic<std::uint32_t>*>(carriage.scratch)),
        receivers_(carriage.receivers) {}
  void add() noexcept { count_->fetch_add(1, std::memory_order_release); }
  bool is_complete() const noexcept {
    return count_->load(std::memory_order_acquire) == receivers_;
  }

 private:
  static_assert(std::atomic<std::uint32_t>::is_always_lock_free);
  std::atomic<std::uint32_t>* count_;
  std::size_t receivers_;
};

}  // namespace agnocast::bench
