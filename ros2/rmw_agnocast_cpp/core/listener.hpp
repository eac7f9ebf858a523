// SPDX-License-Identifier: Apache-2.0
//
// Listener: calls a function when something has come, instead of a thread that waits for it (rmw's
// "set on new …" functions, from which an executor that sleeps in one place is made).
//
// One thread for all of a context, from the first callback on. It compares how many have come with
// how many it has reported: a node that takes once for each that is reported misses none, and may
// find nothing at times.
#pragma once

#include <agnocast/events.hpp>
#include <agnocast/result.hpp>
#include <ros2/rmw_agnocast_cpp/core/wait_set.hpp>

#include <signal.h>
#include <sys/types.h>

#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace agnocast::rmw {

/// What a Listener can listen to: it counts what has come.
class Listenable : public Readable {
 public:
  /// As of SubscriptionBase::get_arrivals(). A count that falls (0 once the session is revoked) is
  /// a new beginning.
  virtual Arrivals arrivals() const noexcept = 0;

 private:
  friend class Listener;
  std::uint64_t reported_ = 0;  // under the mutex of the listener
};

/// Any thread may call any function.
class Listener {
 public:
  /// `count`: how many have come since the last call, at least 1. Must not throw.
  using Callback = void (*)(const void* user_data, std::size_t count);

  /// The pool must outlive it.
  explicit Listener(WaitPool& pool) noexcept;
  ~Listener();  // not from a callback
  Listener(const Listener&) = delete;
  Listener& operator=(const Listener&) = delete;

  /// From now on calls `callback` in the listener's thread, with the signals blocked that the
  /// calling thread blocks now; null ends that. What came before is reported at once, as far as no
  /// callback was notified of it and nobody has taken it. When this function returns, an earlier
  /// callback of `to` runs no more, unless it is what calls this. `to` must stay until forget().
  /// Errors: as MessageWait::try_create; os_failure: no thread can be started; shut_down: a forked
  /// child, which has no such thread. Throws std::bad_alloc.
  [[nodiscard]] Result<void> listen(Listenable& to, Callback callback, const void* user_data);
  void forget(Listenable& to) noexcept;

 private:
  struct Entry {
    Listenable* to;
    Callback callback;
    const void* user_data;
    sigset_t signals;
  };
  Result<void> begin();
  void run() noexcept;
  void report() noexcept;
  bool has_news() const noexcept;
  MessageWait::Clock::time_point due() const noexcept;
  void wait_for_callback(std::unique_lock<std::mutex>& lock, const Listenable& of) noexcept;

  WaitPool& pool_;
  const pid_t process_;
  mutable std::mutex mutex_;
  std::condition_variable callback_ended_, has_entries_;
  std::vector<Entry> entries_;
  const Listenable* running_ = nullptr;  // whose callback runs
  std::uint64_t call_ = 0;               // its number
  bool is_changed_ = false;              // entries_, since the last report()
  bool is_over_ = false;
  std::unique_ptr<MessageWait> wait_;  // of the thread; null: there is none
  std::thread thread_;
};

}  // namespace agnocast::rmw
