// SPDX-License-Identifier: Apache-2.0
//
// TwiceOwned: messages that are in two queues of this process. When a publisher moves to a new
// daemon, it takes the history for late joiners along, while readers may still hold the messages
// through the previous queue. The queue that releases a message last destroys it.
#pragma once

#include <base/immortal.hpp>

#include <atomic>
#include <cstddef>
#include <mutex>
#include <unordered_map>

namespace agnocast {

class TwiceOwned {
 public:
  static TwiceOwned& instance() noexcept { return immortal<TwiceOwned>(); }
  /// Notes one more queue that has this message. Throws bad_alloc.
  void share(void* message) {
    const std::lock_guard lock(mutex_);
    ++others_[message];
    count_.store(others_.size(), std::memory_order_release);
  }
  /// Releases the message from a queue. Returns whether another queue still has it.
  bool release(void* message) noexcept {
    if (count_.load(std::memory_order_acquire) == 0) return false;
    const std::lock_guard lock(mutex_);
    const auto found = others_.find(message);
    if (found == others_.end()) return false;
    if (--found->second == 0) others_.erase(found);
    count_.store(others_.size(), std::memory_order_release);
    return true;
  }

 private:
  std::mutex mutex_;
  std::unordered_map<void*, std::size_t> others_;  // queues beyond the first
  std::atomic<std::size_t> count_{0};
};

}  // namespace agnocast
