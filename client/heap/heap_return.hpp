// SPDX-License-Identifier: Apache-2.0
//
// HeapReturn: returns unneeded memory of this process's shared heap to the system.
//
// After a spike the heap has the size of the spike: freed memory stays resident, because that
// makes the next message cheap. Memory that was not needed for AGNOCAST_HEAP_IDLE_SECONDS is
// returned, all at once.
//
//   control thread, once a second: is much idle? → agnocast-purge, check by check:
//        less than much: it is needed, stop → the control thread checks again
//        much all the time → purge, stop
//
// Idle memory is the minimum of the idle memory at any moment since the previous check (idle of
// the hook), so traffic that needs its memory now and then keeps it. The system takes a while for
// each page, so a thread of its own does the purge; it is made at the first purge, and sleeps
// otherwise. Which threads wait for it, and how long: docs/heaphook.md, "Giving memory back".
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

  /// Returns AGNOCAST_HEAP_IDLE_SECONDS; nothing: memory is never returned. Errors:
  /// invalid_argument.
  [[nodiscard]] static Result<std::optional<std::chrono::seconds>> idle_time();

  /// Call it once, when the heap is open; never if idle_time() is nothing.
  void begin(const agnocast_heaphook_table& hook, std::chrono::seconds idle_time) noexcept;
  /// For control threads, as often as they like.
  void look() noexcept;

 private:
  void serve() noexcept;
  void end() noexcept;
  void watch() noexcept;
  bool has_much() const noexcept;
  std::chrono::milliseconds pause() const noexcept;

  std::atomic<const agnocast_heaphook_table*> hook_{nullptr};
  std::chrono::seconds idle_time_{};
  std::mutex looking_;  // control threads: each session has one
  Clock::time_point next_look_{};
  bool has_thread_ = false;
  std::atomic<bool> watches_{false};
};

}  // namespace agnocast
