// SPDX-License-Identifier: Apache-2.0
//
// GroupCallbacks: the callbacks of one callback group, and the executor that runs them.
//
// In a mutually exclusive group they run one at a time, in any thread. A thread of the executor
// begins a callback, runs it without a lock, and ends it; hand_to() changes the executor at any
// time, also meanwhile. Nothing is lost or doubled by that: a message is taken only where its
// callback is called, by the executor of that moment; the new executor finds unread messages, and
// if a callback still runs elsewhere it is woken when that one has ended.
//
// The wait set was announced to the publishers when the first subscription was created, so it
// stays the group's in every executor. Groups may share one (callback_groups.hpp).
#pragma once

#include <agnocast/callback_group.hpp>
#include <base/undestroyed_condition.hpp>
#include <client/process/library_thread.hpp>
#include <client/process/thread_register.hpp>
#include <client/process/wait_set.hpp>

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {

class ExecutorCore;

/// Owner of callbacks: a subscription, the events of a publisher, or a timer.
class CallbackSource {
 public:
  using Clock = std::chrono::steady_clock;
  /// `is_serial`: run_one() never runs in two threads at once, not even in a reentrant group.
  explicit CallbackSource(bool is_serial = false) noexcept : is_serial_(is_serial) {}
  CallbackSource(const CallbackSource&) = delete;
  CallbackSource& operator=(const CallbackSource&) = delete;
  virtual ~CallbackSource() = default;

  virtual bool has_work() const noexcept = 0;
  /// When there will be work without a doorbell: the next time of a timer.
  virtual Clock::time_point due() const noexcept { return Clock::time_point::max(); }
  /// Runs at most one callback; returns whether there was one. Throws what it throws. In a
  /// reentrant group several threads call it at once.
  virtual bool run_one() = 0;

  /// Exceptions without a receiver: see docs/nodes.md.
  std::atomic<std::uint64_t> exception_count{0};
  /// Signal mask of the creating thread, which its callbacks see in a library thread.
  const SignalMask signals;

 private:
  friend class GroupCallbacks;
  const bool is_serial_;
  std::uint64_t cycle_ = 0;  // of the executor: when it ran last. Under the group's mutex
};

class GroupCallbacks {
 public:
  explicit GroupCallbacks(CallbackGroupType type, std::string node = {}, std::string name = {})
      : type_(type), node_(std::move(node)), name_(std::move(name)) {
    running_.reserve(1);
  }
  GroupCallbacks(const GroupCallbacks&) = delete;
  GroupCallbacks& operator=(const GroupCallbacks&) = delete;

  CallbackGroupType type() const noexcept { return type_; }
  /// Returns a number that no other group or executor of this process has.
  std::uint64_t number() const noexcept { return number_; }
  /// The fully qualified name of its node.
  const std::string& node() const noexcept { return node_; }
  const std::string& name() const noexcept { return name_; }
  void add(std::shared_ptr<CallbackSource> source);
  /// Ends the callbacks of a source; waits while another thread runs one. It does not wait if
  /// that wait would never end: the callback waits for this thread (callback_waits.hpp), or this
  /// thread is inside exit() and has waited long enough. `group` lives until every callback that
  /// still runs then has ended, so that endpoints that it creates next have the same executor.
  void remove(CallbackSource& source, const std::shared_ptr<const void>& group) noexcept;

  /// Null: not yet needed. Set once.
  std::shared_ptr<WaitSet> wait_set() const noexcept {
    const std::lock_guard lock(mutex_);
    return wait_set_;
  }
  void set_wait_set(std::shared_ptr<WaitSet> wait_set) noexcept {
    const std::lock_guard lock(mutex_);
    wait_set_ = std::move(wait_set);
  }

  /// Ends the sleep of its executor: a source is due earlier than it was. Any thread.
  void wake() noexcept;

  /// Null: nobody runs them. The executor hands it to another one before it is destroyed.
  void hand_to(ExecutorCore* executor) noexcept;

  // --- for the executor; for all others these find nothing

  /// Begins a callback of the first source that has had none in this `cycle` and has work, and
  /// returns it; null if there is none, or the group is busy. Call end() with the source.
  /// `is_alone`: there is no other group in the executor. Then a single source is asked by
  /// taking: it rarely has nothing, and then that only costs more. Throws std::bad_alloc
  /// (reentrant).
  std::shared_ptr<CallbackSource> begin(const ExecutorCore& executor, std::uint64_t cycle,
                                        bool is_alone);
  /// Like begin(), but of the source with work whose last callback began longest ago, in the
  /// smallest cycle. Throws std::bad_alloc (reentrant).
  std::shared_ptr<CallbackSource> begin_oldest(const ExecutorCore& executor, std::uint64_t cycle);
  /// In the thread that has begun it. `source` is only compared: it may have ended.
  void end(const ExecutorCore& executor, const CallbackSource* source) noexcept;
  /// Returns whether a callback could begin; otherwise `due` becomes the time of a timer that
  /// comes before it.
  bool has_work(const ExecutorCore& executor,
                CallbackSource::Clock::time_point& due) const noexcept;
  /// Returns how many sources could begin a callback.
  std::size_t ready_count(const ExecutorCore& executor) const noexcept;

 private:
  struct Running {
    const CallbackSource* source;
    std::thread::id thread;
    std::shared_ptr<const void> until_end;
  };
  // Under the mutex:
  std::shared_ptr<CallbackSource> begin(const std::shared_ptr<CallbackSource>& source,
                                        std::uint64_t cycle);
  bool wait_for_end(const CallbackSource& source, std::unique_lock<std::mutex>& lock) noexcept;
  bool is_free() const noexcept;
  bool is_free(const CallbackSource& source) const noexcept;

  const CallbackGroupType type_;
  const std::uint64_t number_ = ThreadRegister::next_number();
  const std::string node_, name_;
  mutable std::mutex mutex_;  // taken after that of the executor
  UndestroyedCondition callback_ended_;
  std::vector<std::shared_ptr<CallbackSource>> sources_;
  std::shared_ptr<WaitSet> wait_set_;
  ExecutorCore* executor_ = nullptr;
  std::vector<Running> running_;
  std::size_t waiters_ = 0;  // for the end of a callback
};

}  // namespace agnocast
