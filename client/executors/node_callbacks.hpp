// SPDX-License-Identifier: Apache-2.0
//
// NodeCallbacks: the callbacks of one node, and who runs them.
//
// They run one at a time, whoever runs them (one mutually exclusive group per node). Their *host* is
// a library thread of the node or an executor; hand_to() changes it at any time, also while a
// callback runs. Nothing is lost or doubled by that: a message is taken where its callback is called
// and nowhere else, by the host of that moment; the new host finds what is unread, and if a callback
// still runs elsewhere it is woken when that one has ended.
//
// Every node keeps the sleeper that its subscriptions were created with, because the daemon has told
// it to the publishers. Only the host arms it, and both happen under one mutex: a former host
// that returns from its sleep late must not disarm the word of the new one.
#pragma once

#include <client/process/library_thread.hpp>
#include <client/process/sleeper.hpp>

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

/// What has callbacks: a subscription, or the events of a publisher.
class CallbackSource {
 public:
  CallbackSource() = default;
  CallbackSource(const CallbackSource&) = delete;
  CallbackSource& operator=(const CallbackSource&) = delete;
  virtual ~CallbackSource() = default;

  virtual bool has_work() const noexcept = 0;
  /// At most one callback; true if there was one. Throws what it throws.
  virtual bool run_one() = 0;

  /// Exceptions that nobody could be given: see docs/nodes.md.
  std::atomic<std::uint64_t> exception_count{0};
  /// Of the thread that has made it: what its callbacks see in a library thread.
  const SignalMask signals;

 private:
  friend class NodeCallbacks;
  bool removed_ = false;  // under the mutex of NodeCallbacks
};

class NodeCallbacks {
 public:
  /// A host is known by an address.
  using Host = const void*;

  /// `node`: its fully qualified name.
  NodeCallbacks(std::string node, std::shared_ptr<Sleeper> sleeper) noexcept
      : node_(std::move(node)), sleeper_(std::move(sleeper)) {}
  NodeCallbacks(const NodeCallbacks&) = delete;
  NodeCallbacks& operator=(const NodeCallbacks&) = delete;

  const std::string& node() const noexcept { return node_; }
  const std::shared_ptr<Sleeper>& sleeper() const noexcept { return sleeper_; }
  void add(std::shared_ptr<CallbackSource> source);
  /// Afterwards its callback is not running and will not run, unless this is called from inside a
  /// callback of the node: then `runner` stays until that one has ended, so that what it creates
  /// next for the node has the same host. So it does where a wait would never end: the callback waits
  /// for this thread (callback_waits.hpp), or this thread is inside exit() and has waited long enough.
  void remove(CallbackSource& source, std::shared_ptr<const void> runner) noexcept;

  void hand_to(Host host) noexcept;
  /// Blocks until `host` is the host (true) or stop() was called (false).
  bool await(Host host) noexcept;
  void stop() noexcept;

  // --- the host; for anybody else these do nothing and see nothing

  /// Appends the sources, in the order in which they were added: the answer of list_changes() for
  /// which that is the list.
  std::uint64_t list(Host host, std::vector<std::weak_ptr<CallbackSource>>& sources) const;
  /// Another number whenever list() would append something else. Never 0.
  std::uint64_t list_changes() const noexcept { return changes_.load(std::memory_order_acquire); }
  /// False while a former host is still inside a callback.
  bool has_work(Host host) const noexcept;
  /// At most one callback of `source`; true if there was one. Throws what it throws. Takes locks also
  /// where there is none: who has many sources asks each for its has_work() first.
  bool run(Host host, CallbackSource& source);
  /// Order of a sleep: arm, look, block on the bells, disarm (docs/protocol.md). True when the look
  /// finds work, and then nothing is armed.
  bool arm_or_find_work(Host host) noexcept;
  void disarm(Host host) noexcept;
  /// The datagram bell rang.
  void drain(Host host) noexcept;

 private:
  struct Ending;
  bool wait_for_end(const CallbackSource& source, std::unique_lock<std::mutex>& lock) noexcept;
  bool has_work_here(Host host) const noexcept;  // under the mutex
  void count_change() noexcept {                 // under the mutex
    changes_.store(changes_.load(std::memory_order_relaxed) + 1, std::memory_order_release);
  }

  const std::string node_;
  const std::shared_ptr<Sleeper> sleeper_;
  mutable std::mutex mutex_;
  // Apart, because a callback ends with each message: whoever waits to be the host is not woken by that.
  std::condition_variable host_changed_;  // or stop
  std::condition_variable callback_ended_;
  std::vector<std::shared_ptr<CallbackSource>> sources_;
  std::atomic<std::uint64_t> changes_{1};  // of the sources or the host; written under the mutex
  Host host_ = nullptr;
  const CallbackSource* running_ = nullptr;
  std::thread::id running_thread_;
  std::size_t waiters_ = 0;  // for the end of what runs
  std::shared_ptr<const void> until_end_;  // of what runs
  bool armed_ = false;
  bool stopped_ = false;
};

}  // namespace agnocast
