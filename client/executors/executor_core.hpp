// SPDX-License-Identifier: Apache-2.0
//
// ExecutorCore: an executor without its public part: its groups, their cycles, its sleep.
//
// One epoll set has the doorbells of every wait set and an eventfd of the executor itself, so a
// sleep is one epoll_wait. Falling asleep arms as many words as the groups have wait sets, and a
// publisher with subscriptions on two of them rings twice.
//
// In a *cycle* each source may run one callback. So a fast topic does not starve the others, in
// any group.
//
// Any number of threads may spin. At most one of them sleeps on the doorbells; the others wait to
// be the next. A thread that begins a callback lets one of them look and sleep in its place. A
// busy group is invisible to the thread that looks, and nobody rings when it becomes free; so the
// thread that freed it looks again before it waits, or wakes the sleeping one if it stops: as many
// threads look as groups became free. tests/model/executor_scenario.hpp explores that.
//
// Any thread may add and remove groups (callback_groups.cpp orders that).
#pragma once

#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <base/undestroyed_condition.hpp>
#include <client/executors/group_callbacks.hpp>
#include <client/executors/sleep_tick.hpp>
#include <client/process/thread_register.hpp>

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

namespace agnocast {

class ExecutorCore {
 public:
  using Clock = std::chrono::steady_clock;

  /// A callback that has begun: its group counts it until this object is destroyed.
  class Claim {
   public:
    Claim() = default;
    Claim(ExecutorCore& core, std::shared_ptr<GroupCallbacks> group,
          std::shared_ptr<CallbackSource> source) noexcept
        : core_(&core), group_(std::move(group)), source_(std::move(source)) {}
    Claim(Claim&& other) noexcept
        : core_(std::exchange(other.core_, nullptr)),
          group_(std::move(other.group_)),
          source_(std::move(other.source_)) {}
    Claim& operator=(Claim&&) = delete;
    ~Claim() {
      if (core_ == nullptr) return;
      const CallbackSource* const ended = source_.get();
      // Before the end: nobody else runs the callback's destructor, nor later, nor beside others of
      // the group.
      source_.reset();
      group_->end(*core_, ended);
    }
    explicit operator bool() const noexcept { return core_ != nullptr; }
    CallbackSource& source() const noexcept { return *source_; }

   private:
    ExecutorCore* core_ = nullptr;
    std::shared_ptr<GroupCallbacks> group_;
    std::shared_ptr<CallbackSource> source_;  // may own the callback
  };

  /// Errors: os_failure.
  [[nodiscard]] static Result<std::unique_ptr<ExecutorCore>> make();
  ~ExecutorCore();
  ExecutorCore(const ExecutorCore&) = delete;
  ExecutorCore& operator=(const ExecutorCore&) = delete;

  // --- any thread

  /// Takes over the callbacks of this group. Errors: os_failure.
  [[nodiscard]] Result<void> adopt(const std::shared_ptr<GroupCallbacks>& group);
  /// Begins to listen for a group that it has, in place of another wait set. Errors: os_failure.
  [[nodiscard]] Result<void> listen(const GroupCallbacks& group, std::shared_ptr<WaitSet> wait_set);
  /// Releases its doorbells; nobody runs the group then. Does nothing if it is not here.
  void drop(GroupCallbacks& group) noexcept;

  /// Ends a sleep. Any thread, any signal handler.
  void wake() noexcept;
  /// wake(), and is_cancelled() until take_cancel().
  void cancel() noexcept;
  bool is_cancelled() const noexcept { return cancelled_.load(std::memory_order_acquire); }
  bool take_cancel() noexcept {
    return is_cancelled() && cancelled_.exchange(false, std::memory_order_acq_rel);
  }
  /// Returns a number that no other executor of this process has.
  std::uint64_t number() const noexcept { return number_; }
  /// Readable when a sleep of this executor would end.
  int fd() const noexcept { return epoll_.get(); }

  // --- a thread that spins

  /// Set while several threads spin.
  void share(bool several) noexcept { is_shared_.store(several, std::memory_order_relaxed); }
  bool is_shared() const noexcept { return is_shared_.load(std::memory_order_relaxed); }

  /// Begins the next callback of this cycle, or of a new one; empty if there is none. Throws
  /// std::bad_alloc.
  Claim next();
  /// Runs it; returns false if there was nothing to do after all. Throws what it throws.
  bool run_next();
  /// Like run_next(), without cycles: of the ready sources it runs the one whose last callback
  /// began longest ago. For a loop whose own cycles are not those of this executor.
  bool run_oldest();
  /// Runs the rest of this cycle, or a whole new one if nothing is left of it; stops at
  /// `deadline` or a cancel. Returns the number of callbacks. Throws what they throw.
  std::size_t run_cycle(Clock::time_point deadline);
  bool has_work() const noexcept;
  /// Returns how many callbacks could begin, one of each source.
  std::size_t ready_count() const noexcept;

  /// Sleeps until there may be something to do, or `timeout` is over (none: the next tick). With
  /// several threads it may be another one that sleeps; then `timeout` must be none.
  /// `in_cancellable_thread`: the thread can be cancelled (pthread_cancel) while it sleeps.
  void wait(std::optional<std::chrono::milliseconds> timeout, bool in_cancellable_thread = false);
  /// Call it when a thread stops while others go on: another one takes over its work.
  void leave() noexcept;

  // --- one thread with a loop of its own

  /// Drains rung doorbells, arms, then checks: returns true, and leaves nothing armed, if there
  /// is work.
  bool prepare() noexcept;
  /// Notes the rung doorbells and disarms.
  void finish_sleep() noexcept;
  /// Drains rung doorbells, in case other code uses fd() before the next prepare().
  void end_dispatch() noexcept;

 private:
  /// A wait set of groups that are here.
  struct Listened {
    std::shared_ptr<WaitSet> wait_set;
    std::uint64_t tag;       // of its datagram doorbell in the epoll set
    std::size_t groups = 1;  // that use it
    bool is_armed = false;
    // Drain its datagram doorbell before the next sleep, but after the callback that it rang for.
    bool has_rung = false;
  };
  struct Assigned {
    std::shared_ptr<GroupCallbacks> group;
    std::shared_ptr<WaitSet> wait_set;  // null: it has none yet
  };
  class Sleeping;

  ExecutorCore(UniqueFd epoll, UniqueFd wake, SleepTick tick) noexcept
      : epoll_(std::move(epoll)), wake_(std::move(wake)), tick_(std::move(tick)) {}
  // All under the mutex:
  Result<void> begin_listening(std::shared_ptr<WaitSet> wait_set);
  void end_listening(const std::shared_ptr<WaitSet>& wait_set) noexcept;
  Claim begin_of_cycle();
  Claim begin_oldest();
  bool run_claimed(Claim (ExecutorCore::*claim_one)());
  void pass_on() noexcept;
  bool has_work_here(Clock::time_point& due) const noexcept;
  bool arm_or_find_work() noexcept;
  void disarm() noexcept;
  void note_events(const struct epoll_event* events, int count) noexcept;
  void drain_rung() noexcept;

  const std::uint64_t number_ = ThreadRegister::next_number();
  UniqueFd epoll_, wake_;
  SleepTick tick_;
  std::atomic<bool> cancelled_{false};
  static_assert(std::atomic<bool>::is_always_lock_free, "cancel() is for signal handlers");
  std::atomic<bool> is_shared_{false};

  mutable std::mutex mutex_;
  std::vector<Assigned> assigned_;
  std::vector<Listened> listened_;
  std::uint64_t last_tag_ = 0;
  std::uint64_t cycle_ = 1;
  std::size_t next_ = 0;  // the group where the cycle goes on

  bool is_asleep_ = false;       // a thread is in wait(), on the doorbells
  std::size_t successors_ = 0;   // threads in wait() that are not
  std::uint64_t passed_on_ = 0;  // how often one of them was asked to look
  UndestroyedCondition passed_;
};

}  // namespace agnocast
