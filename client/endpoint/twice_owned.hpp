// SPDX-License-Identifier: Apache-2.0
//
// TwiceOwned: messages that lie in two queues of this process. When a publisher moves to a new
// daemon, the history that it keeps for late joiners goes along, while readers may still hold it by
// the former queue. Whichever releases it last destroys the message.
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
  /// One queue more has this message. Throws bad_alloc.
  void share(void* message) {
    const std::lock_guard lock(mutex_);
    ++others_[message];
    count_.store(others_.size(), std::memory_order_release);
  }
  /// A queue releases it. True: another one still has it.
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
