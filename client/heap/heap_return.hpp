// SPDX-License-Identifier: Apache-2.0
//
// HeapReturn: gives back to the system what nobody wants any more of this process's shared heap.
//
// After a spike the heap has the size of the spike: freed memory stays resident, because that makes the
// next message cheap. What has not been wanted for AGNOCAST_HEAP_IDLE_SECONDS goes back, all at once.
//
//   control thread, once a second: is much idle? → agnocast-purge, look by look:
//        less than much: somebody wants it, over → the control thread goes on looking
//        much all the time → purge, over
//
// What is idle is the least of what was idle at any moment since the look before (idle of the hook), so
// traffic that wants its memory now and then keeps it. The system takes a while for each page: so it has
// a thread of its own, which is made when there is something to give back first, and sleeps otherwise.
// What waits for it, and how long: docs/heaphook.md, "Giving memory back".
#pragma once

#include <agnocast/abi/heaphook.h>
#include <agnocast/result.hpp>

#include <atomic>
#include <chrono>
#include <mutex>
#include <optional>

namespace agnocast {

class HeapReturn {
 public:
  using Clock = std::chrono::steady_clock;

  HeapReturn() noexcept = default;
  static HeapReturn& instance() noexcept;

  /// What AGNOCAST_HEAP_IDLE_SECONDS says: none: memory is never given back. Errors: invalid_argument.
  [[nodiscard]] static Result<std::optional<std::chrono::seconds>> idle_time();

  /// The heap is open. Once, and never with none.
  void begin(const agnocast_heaphook_table& hook, std::chrono::seconds idle_time) noexcept;
  /// Control threads, as often as they like.
  void look() noexcept;

 private:
  void serve() noexcept;
  void end() noexcept;
  void watch() noexcept;
  bool has_much() const noexcept;
  std::chrono::milliseconds pause() const noexcept;

  std::atomic<const agnocast_heaphook_table*> hook_{nullptr};
  std::chrono::seconds idle_time_{};
  std::mutex looking_;  // control threads; several memberships have several
  Clock::time_point next_look_{};
  bool has_thread_ = false;
  std::atomic<bool> watches_{false};
};

}  // namespace agnocast
