// SPDX-License-Identifier: Apache-2.0
//
// CallbackWaits: the waits between threads, where one destroys an object whose callback another
// one runs. Two callbacks that destroy each other's subscription would wait for each other for
// ever: a thread that would close such a cycle does not wait. Waits for locks of the user are
// unknown here.
//
// Its mutex is innermost. A thread that ends a callback erases the waits for it, so that no
// finished wait counts.
#pragma once

#include <base/immortal.hpp>

#include <map>
#include <mutex>
#include <new>
#include <thread>

namespace agnocast {

class CallbackWaits {
 public:
  static CallbackWaits& instance() noexcept { return immortal<CallbackWaits>(); }

  /// Registers that this thread will wait for `other`, which runs `what` (null: anything).
  /// Returns false if that one waits for this one, directly or through others.
  bool begin(std::thread::id other, const void* what) noexcept {
    const std::lock_guard lock(mutex_);
    const std::thread::id self = std::this_thread::get_id();
    // There is no cycle in the table, so this ends.
    for (std::thread::id next = other;;) {
      if (next == self) return false;
      const auto found = waits_.find(next);
      if (found == waits_.end()) break;
      next = found->second.other;
    }
    try {
      waits_.insert_or_assign(self, Wait{other, what});
    } catch (const std::bad_alloc&) {
      // The thread waits, but others cannot see that.
    }
    return true;
  }
  /// Removes this thread's wait.
  void end() noexcept {
    const std::lock_guard lock(mutex_);
    waits_.erase(std::this_thread::get_id());
  }
  /// Removes all waits for what this thread ran of `what`: it has ended.
  void end_of(const void* what) noexcept {
    const std::lock_guard lock(mutex_);
    std::erase_if(waits_, [&, self = std::this_thread::get_id()](const auto& wait) {
      return wait.second.what == what && wait.second.other == self;
    });
  }

 private:
  struct Wait {
    std::thread::id other;
    const void* what;
  };

  std::mutex mutex_;
  std::map<std::thread::id, Wait> waits_;
};

}  // namespace agnocast
