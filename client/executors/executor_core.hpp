// SPDX-License-Identifier: Apache-2.0
//
// ExecutorCore: an executor without its public part: its nodes, their cycles, its sleep.
//
// One epoll set has the doorbells of every node and an eventfd of the executor itself, so a sleep
// is one epoll_wait. Each node keeps a sleep word of its own (see NodeCallbacks), so falling
// asleep arms as many words as there are nodes, and a publisher with subscriptions in two nodes
// of one executor rings twice.
//
// A *cycle* is a list of all callback sources; each may run one callback in it. So a fast topic
// does not starve the others, in any node. The list refers weakly: a destroyed subscription frees
// the objects of its callback at once. The list is made anew when a node or a source was added or
// removed.
//
// Any thread may add and remove nodes (client/executors/runner.cpp orders that); everything else
// is for the one thread that spins, except wake() and cancel().
#pragma once

#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <client/executors/node_callbacks.hpp>
#include <client/executors/sleep_tick.hpp>

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace agnocast {

class ExecutorCore {
 public:
  using Clock = std::chrono::steady_clock;

  /// Errors: os_failure.
  [[nodiscard]] static Result<std::unique_ptr<ExecutorCore>> make();
  ~ExecutorCore();
  ExecutorCore(const ExecutorCore&) = delete;
  ExecutorCore& operator=(const ExecutorCore&) = delete;

  /// Takes over the callbacks of this node. Errors: os_failure.
  [[nodiscard]] Result<void> adopt(std::shared_ptr<NodeCallbacks> node);
  /// Releases its doorbells; the caller gives it another executor, or ends it.
  void drop(const NodeCallbacks& node) noexcept {
    drop_if([&](const NodeCallbacks& assigned) { return &assigned == &node; });
  }
  /// The same for all of this name (one that is about to end may be among them).
  void drop(const std::string& node) noexcept {
    drop_if([&](const NodeCallbacks& assigned) { return assigned.node() == node; });
  }

  /// Ends a sleep. Any thread, any signal handler.
  void wake() noexcept;
  /// wake(), and is_cancelled() until take_cancel().
  void cancel() noexcept;
  bool is_cancelled() const noexcept { return cancelled_.load(std::memory_order_acquire); }
  bool take_cancel() noexcept {
    return is_cancelled() && cancelled_.exchange(false, std::memory_order_acq_rel);
  }

  /// Readable when a sleep of this executor would end.
  int fd() const noexcept { return epoll_.get(); }

  // --- the thread that spins

  /// Runs the next callback of the cycle; returns false if there is none. Throws what it throws.
  bool run_next();
  /// Runs the rest of this cycle, or a whole new one if nothing is left of it; stops at
  /// `deadline` or a cancel. Returns the number of callbacks. Throws what they throw.
  std::size_t run_cycle(Clock::time_point deadline);
  bool has_work() const noexcept;
  /// Drains rung doorbells, arms, then checks: returns true, and leaves nothing armed, if there
  /// is work.
  bool prepare() noexcept;
  /// Blocks until a doorbell, a wake, or the end of `timeout` (none: the next tick); then
  /// disarms. With a `timeout` of 0 it notes the rung doorbells and disarms.
  void sleep(std::optional<std::chrono::milliseconds> timeout) noexcept;
  /// Drains rung doorbells, in case other code uses fd() before the next prepare().
  void end_dispatch() noexcept;

 private:
  struct Assigned {
    std::shared_ptr<NodeCallbacks> node;
    std::uint64_t tag;  // of its datagram doorbell in the epoll set
    // Drain its datagram doorbell before the next sleep, but after the callback that it rang for.
    bool has_rung = false;
    std::uint64_t listed = 0;  // its list_changes() when cycle_ was made; 0: not in the list
  };
  struct Cycle {
    std::weak_ptr<NodeCallbacks> node;
    std::weak_ptr<CallbackSource> source;
  };

  ExecutorCore(UniqueFd epoll, UniqueFd wake, SleepTick tick) noexcept
      : epoll_(std::move(epoll)), wake_(std::move(wake)), tick_(std::move(tick)) {}
  template <class Condition>
  void drop_if(Condition condition) noexcept {
    const std::lock_guard lock(mutex_);
    cycle_is_listed_ = false;
    std::erase_if(assigned_, [&](const Assigned& assigned) {
      if (!condition(*assigned.node)) return false;
      assigned.node->wait_set()->remove_from(epoll_.get());
      return true;
    });
  }
  void begin_cycle();
  bool is_cycle_current() const noexcept;  // under the mutex, like the next
  void drain_rung() noexcept;
  bool run_one_of_cycle();

  UniqueFd epoll_, wake_;
  SleepTick tick_;
  std::atomic<bool> cancelled_{false};
  static_assert(std::atomic<bool>::is_always_lock_free, "cancel() is for signal handlers");
  mutable std::mutex mutex_;
  std::vector<Assigned> assigned_;
  std::uint64_t last_tag_ = 0;
  bool cycle_is_listed_ = false;  // current, unless a node reports changes

  std::vector<Cycle> cycle_;
  std::size_t next_ = 0;
  std::vector<std::weak_ptr<CallbackSource>> listed_;  // kept for its capacity
};

}  // namespace agnocast
