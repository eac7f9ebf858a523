// SPDX-License-Identifier: Apache-2.0
//
// ExecutorCore: an executor without its public face: the nodes it hosts, their turns, its sleep.
//
// One epoll set holds the bells of every node and an eventfd of the executor itself, so a sleep is
// one epoll_wait, whoever ends it. Each node keeps a sleep word of its own (see NodeCallbacks), so
// falling asleep arms as many words as there are nodes, and a publisher that two nodes of one
// executor listen to rings twice.
//
// A *turn* is a list of all callback sources; each may run one callback in it. So a fast topic does
// not starve the others, whichever nodes they belong to. The list refers weakly: a subscription that
// goes takes what its callback holds with it. It is made anew when a node or a source came or went.
//
// Nodes come and go in any thread (client/executors/runner.cpp orders that); everything else is for the one
// thread that spins, except wake() and cancel().
#pragma once

#include <agnocast/result.hpp>
#include <base/unique_fd.hpp>
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

  /// From now on the callbacks of this node are this executor's. Errors: os_failure.
  [[nodiscard]] Result<void> adopt(std::shared_ptr<NodeCallbacks> node);
  /// Its bells are let go; the caller gives it another host, or ends it.
  void drop(const NodeCallbacks& node) noexcept {
    drop_if([&](const NodeCallbacks& hosted) { return &hosted == &node; });
  }
  /// The same, for all of this name (one that is about to end can be there as well).
  void drop(const std::string& node) noexcept {
    drop_if([&](const NodeCallbacks& hosted) { return hosted.node() == node; });
  }

  /// Ends a sleep. Any thread, any signal handler.
  void wake() noexcept;
  /// wake(), and is_cancelled() until somebody takes note of it.
  void cancel() noexcept;
  bool is_cancelled() const noexcept { return cancelled_.load(std::memory_order_acquire); }
  bool take_cancel() noexcept {
    return is_cancelled() && cancelled_.exchange(false, std::memory_order_acq_rel);
  }

  /// Readable when a sleep of this executor would end.
  int fd() const noexcept { return epoll_.get(); }

  // --- the thread that spins

  /// The next callback in turn; false when there is none. Throws what it throws.
  bool run_next();
  /// The rest of this turn, or a whole new one if nothing is left of it; not beyond `deadline` nor a
  /// cancel. The number of callbacks. Throws what they throw.
  std::size_t run_turn(Clock::time_point deadline);
  bool has_work() const noexcept;
  /// Empties the bells that rang, arms, then looks: true when there is work, and nothing is armed then.
  bool prepare() noexcept;
  /// Blocks until a bell rings, a wake, or `timeout` is over (none: the next tick); then disarms. A
  /// `timeout` of 0 takes note of what rang and disarms.
  void sleep(std::optional<std::chrono::milliseconds> timeout) noexcept;
  /// For one that may not prepare() before others look at fd(): empties the bells that rang.
  void end_dispatch() noexcept;

 private:
  struct Hosted {
    std::shared_ptr<NodeCallbacks> node;
    std::uint64_t tag;  // of its datagram bell in the epoll set
    // Its datagram bell is to be emptied before the next sleep: not before the callback that it rang for.
    bool has_rung = false;
    std::uint64_t listed = 0;  // what its list_changes() were for turn_; 0: it is not in there
  };
  struct Turn {
    std::weak_ptr<NodeCallbacks> node;
    std::weak_ptr<CallbackSource> source;
  };

  ExecutorCore(UniqueFd epoll, UniqueFd wake, SleepTick tick) noexcept
      : epoll_(std::move(epoll)), wake_(std::move(wake)), tick_(std::move(tick)) {}
  template <class Condition>
  void drop_if(Condition condition) noexcept {
    const std::lock_guard lock(mutex_);
    turn_is_listed_ = false;
    std::erase_if(hosted_, [&](const Hosted& hosted) {
      if (!condition(*hosted.node)) return false;
      hosted.node->sleeper()->remove_from(epoll_.get());
      return true;
    });
  }
  void begin_turn();
  bool is_turn_current() const noexcept;  // under the mutex, as the next
  void drain_rung() noexcept;
  bool run_one_of_turn();

  UniqueFd epoll_, wake_;
  SleepTick tick_;
  std::atomic<bool> cancelled_{false};
  static_assert(std::atomic<bool>::is_always_lock_free, "cancel() is for signal handlers");
  mutable std::mutex mutex_;
  std::vector<Hosted> hosted_;
  std::uint64_t last_tag_ = 0;
  bool turn_is_listed_ = false;  // current, unless a node says otherwise

  std::vector<Turn> turn_;
  std::size_t next_ = 0;
  std::vector<std::weak_ptr<CallbackSource>> listed_;  // kept for its capacity
};

}  // namespace agnocast
