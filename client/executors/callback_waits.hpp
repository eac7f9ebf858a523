// SPDX-License-Identifier: Apache-2.0
//
// CallbackWaits: which thread waits for which, where one destroys what has a callback that the other
// runs. Two callbacks that destroy each other's subscription would wait for each other for ever: whoever
// would close such a circle does not wait. Threads that wait for locks of the user's are not known here.
//
// Its mutex is innermost. Who ends a callback erases the waits for it, so that no wait that is over is
// taken for one.
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

  /// This thread is about to wait for `other`, which runs `what` (null: whatever it runs). False: that one
  /// waits for this one, by whatever way.
  bool begin(std::thread::id other, const void* what) noexcept {
    const std::lock_guard lock(mutex_);
    const std::thread::id self = std::this_thread::get_id();
    // No circle is in here, so this ends.
    for (std::thread::id next = other;;) {
      if (next == self) return false;
      const auto found = waits_.find(next);
      if (found == waits_.end()) break;
      next = found->second.other;
    }
    try {
      waits_.insert_or_assign(self, Wait{other, what});
    } catch (const std::bad_alloc&) {
      // It waits, and others cannot see that.
    }
    return true;
  }
  /// This thread waits no more.
  void end() noexcept {
    const std::lock_guard lock(mutex_);
    waits_.erase(std::this_thread::get_id());
  }
  /// `what` is over: nobody waits for it.
  void end_of(const void* what) noexcept {
    const std::lock_guard lock(mutex_);
    std::erase_if(waits_, [&](const auto& wait) { return wait.second.what == what; });
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
