// SPDX-License-Identifier: Apache-2.0
//
// WaitSet: a thread waits until one of several things is ready: messages of subscriptions, events
// of endpoints, and conditions that other threads trigger (rmw's guard conditions).
//
//   attach to all conditions ── look ── sleep ── look ── … ── detach from all, consume
//
// A thread that triggers a condition finds the wait sets that it is attached to, and wakes them: a
// wake-up between look and sleep counts (MessageWait). Messages ring the doorbell of the process,
// so there is nothing to attach to.
//
// rcl makes and fills wait sets for each pass of a loop, so a new one costs no system call: the
// MessageWait comes from a pool when the set first has to sleep.
#pragma once

#include <agnocast/message_wait.hpp>
#include <agnocast/result.hpp>

#include <chrono>
#include <cstddef>
#include <memory>
#include <mutex>
#include <optional>
#include <vector>

namespace agnocast::rmw {

class WaitSet;

/// Triggered until a wait has reported it: several triggers before that are one. Any thread may
/// trigger it, and destroy it while another thread waits for it: then it is not reported.
class Condition {
 public:
  Condition() = default;
  ~Condition();
  Condition(const Condition&) = delete;
  Condition& operator=(const Condition&) = delete;

  /// A system call only for each wait set that sleeps and has it.
  void trigger() noexcept;
  /// Returns whether a wait has it now.
  bool is_waited_for() const noexcept;

 private:
  friend class WaitSet;
  // Under the mutex of all conditions (wait_set.cpp):
  bool is_triggered_ = false;
  std::vector<WaitSet*> waiting_;
};

/// What is ready while its state says so, and is not consumed by waiting for it: a subscription
/// without a callback, a count that has changed.
class Readable {
 public:
  using Clock = MessageWait::Clock;
  virtual ~Readable() = default;
  /// Called by the thread that waits, also between arming and sleeping: it must see what was
  /// published before that.
  virtual bool is_ready() const noexcept = 0;
  /// Returns when the time alone may make it ready; time_point::max(): never.
  virtual Clock::time_point look_due() const noexcept { return Clock::time_point::max(); }
};

/// The MessageWaits that no wait set uses. Any thread.
class WaitPool {
 public:
  /// Errors: as MessageWait::try_create.
  [[nodiscard]] Result<std::unique_ptr<MessageWait>> take();
  void give_back(std::unique_ptr<MessageWait> wait) noexcept;

 private:
  std::vector<std::unique_ptr<MessageWait>> free_;  // under the mutex of all conditions
};

/// One thread at a time. It may wait for other things each time.
class WaitSet {
 public:
  /// The pool must outlive it.
  explicit WaitSet(WaitPool& pool) noexcept : pool_(pool) {}
  ~WaitSet();
  WaitSet(const WaitSet&) = delete;
  WaitSet& operator=(const WaitSet&) = delete;

  using Duration = std::chrono::nanoseconds;
  using Conditions = std::vector<Condition*>;
  using Readables = std::vector<const Readable*>;
  /// Waits until something is ready, for `timeout` at most; without one, as long as it takes; with
  /// none or less it only looks. Consumes the conditions that are ready. Elements may be null, and
  /// may repeat. Returns whether anything is ready: see the functions below. Readables must stay
  /// until it returns; conditions need not. Errors: as MessageWait::try_create; shut_down (in a
  /// forked child). Throws std::bad_alloc.
  [[nodiscard]] Result<bool> wait(const Conditions& conditions, const Readables& readables,
                                  std::optional<Duration> timeout);
  /// Return whether that element was ready when wait() returned.
  bool is_condition_ready(std::size_t i) const noexcept { return ready_conditions_[i]; }
  bool is_readable_ready(std::size_t i) const noexcept { return ready_readables_[i]; }

 private:
  friend class Condition;
  void attach(const Conditions& conditions);
  void detach() noexcept;
  bool has_trigger() const noexcept;
  bool look(const Readables& readables) noexcept;

  WaitPool& pool_;
  std::unique_ptr<MessageWait> wait_;  // null: it has never slept
  // Those that are attached, in the order of the caller; null: none, or destroyed since. Under the
  // mutex of all conditions.
  Conditions attached_;
  std::vector<bool> ready_conditions_, ready_readables_;
};

}  // namespace agnocast::rmw
