// SPDX-License-Identifier: Apache-2.0
//
// NodeCallbacks: the callbacks of one node, and their executor.
//
// They run one at a time in any executor (one mutually exclusive group per node). Their
// *executor* is a library thread of the node or a user's executor; hand_to() changes it at any
// time, also while a callback runs. Nothing is lost or doubled by that: a message is taken only
// where its callback is called, by the executor of that moment; the new executor finds unread
// messages, and if a callback still runs elsewhere it is woken when that one has ended.
//
// Every node keeps the wait set that its subscriptions were created with, because the daemon has
// announced it to the publishers. Only the executor arms it, and both happen under one mutex: a
// previous executor that returns late from its sleep must not disarm the word of the new one.
#pragma once

#include <client/process/library_thread.hpp>
#include <client/process/wait_set.hpp>

#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {

/// Owner of callbacks: a subscription, or the events of a publisher.
class CallbackSource {
 public:
  CallbackSource() = default;
  CallbackSource(const CallbackSource&) = delete;
  CallbackSource& operator=(const CallbackSource&) = delete;
  virtual ~CallbackSource() = default;

  virtual bool has_work() const noexcept = 0;
  /// Runs at most one callback; returns whether there was one. Throws what it throws.
  virtual bool run_one() = 0;

  /// Exceptions without a receiver: see docs/nodes.md.
  std::atomic<std::uint64_t> exception_count{0};
  /// Signal mask of the creating thread, which its callbacks see in a library thread.
  const SignalMask signals;

 private:
  friend class NodeCallbacks;
  bool removed_ = false;  // under the mutex of NodeCallbacks
};

class NodeCallbacks {
 public:
  /// An executor is identified by an address.
  using ExecutorId = const void*;

  /// `node`: its fully qualified name.
  NodeCallbacks(std::string node, std::shared_ptr<WaitSet> wait_set) noexcept
      : node_(std::move(node)), wait_set_(std::move(wait_set)) {}
  NodeCallbacks(const NodeCallbacks&) = delete;
  NodeCallbacks& operator=(const NodeCallbacks&) = delete;

  const std::string& node() const noexcept { return node_; }
  const std::shared_ptr<WaitSet>& wait_set() const noexcept { return wait_set_; }
  void add(std::shared_ptr<CallbackSource> source);
  /// Ends the callbacks of a source; waits for a running one. Called from inside a callback of
  /// the node, it does not wait: `runner` then lives until that callback has ended, so that
  /// endpoints it creates next for the node have the same executor. Likewise if a wait would
  /// never end: the callback waits for this thread (callback_waits.hpp), or this thread is inside
  /// exit() and has waited long enough.
  void remove(CallbackSource& source, std::shared_ptr<const void> runner) noexcept;

  void hand_to(ExecutorId executor) noexcept;
  /// Blocks until `executor` is the executor (true) or stop() was called (false).
  bool await(ExecutorId executor) noexcept;
  void stop() noexcept;

  // --- for the executor; for all others these do nothing and find nothing

  /// Appends the sources, in the order in which they were added. Returns the list_changes() of
  /// that list.
  std::uint64_t list(ExecutorId executor,
                     std::vector<std::weak_ptr<CallbackSource>>& sources) const;
  /// Returns another number whenever list() would append something else. Never 0.
  std::uint64_t list_changes() const noexcept { return changes_.load(std::memory_order_acquire); }
  /// Returns whether there is work; false while a previous executor is still inside a callback.
  bool has_work(ExecutorId executor) const noexcept;
  /// Runs at most one callback of `source`; returns whether there was one. Throws what it throws.
  /// Takes locks even if there is none: with many sources, check has_work() of each first.
  bool run(ExecutorId executor, CallbackSource& source);
  /// To sleep: arm, check, block on the doorbells, disarm (docs/protocol.md). Returns true, and
  /// leaves nothing armed, if the check finds work.
  bool arm_or_find_work(ExecutorId executor) noexcept;
  void disarm(ExecutorId executor) noexcept;
  /// Call it when the datagram doorbell rang.
  void drain(ExecutorId executor) noexcept;

 private:
  struct Ending;
  bool wait_for_end(const CallbackSource& source, std::unique_lock<std::mutex>& lock) noexcept;
  bool has_work_here(ExecutorId executor) const noexcept;  // under the mutex
  void count_change() noexcept {                           // under the mutex
    changes_.store(changes_.load(std::memory_order_relaxed) + 1, std::memory_order_release);
  }

  const std::string node_;
  const std::shared_ptr<WaitSet> wait_set_;
  mutable std::mutex mutex_;
  // Separate, because callbacks end with each message: that must not wake a thread waiting to be
  // the executor.
  std::condition_variable executor_changed_;  // or stop
  std::condition_variable callback_ended_;
  std::vector<std::shared_ptr<CallbackSource>> sources_;
  std::atomic<std::uint64_t> changes_{1};  // of sources or executor; written under the mutex
  ExecutorId executor_ = nullptr;
  const CallbackSource* running_ = nullptr;
  std::thread::id running_thread_;
  std::size_t waiters_ = 0;                // for the end of the running callback
  std::shared_ptr<const void> until_end_;  // of the running callback
  bool armed_ = false;
  bool stopped_ = false;
};

}  // namespace agnocast
