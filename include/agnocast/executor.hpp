// SPDX-License-Identifier: Apache-2.0
//
// Executors: run the callbacks of nodes. Nothing runs until an executor has the node and is spun.
// Which thread runs which callback, and which calls may block: docs/nodes.md.
#pragma once

#include <agnocast/callback_group.hpp>
#include <agnocast/export.hpp>
#include <agnocast/node_like.hpp>

#include <chrono>
#include <cstddef>
#include <future>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>

namespace agnocast {

/// As rclcpp::FutureReturnCode.
enum class FutureReturnCode { SUCCESS, INTERRUPTED, TIMEOUT };

/// The common part of all executors. One thread at a time calls a spin function (or prepare() and
/// dispatch()); any thread may call the other functions. Callbacks of a mutually exclusive group
/// never run at the same time.
///
/// An exception thrown by a callback leaves the spin function as well; the executor can be spun
/// again, and the message of that callback counts as delivered.
///
/// In a forked child that has not called exec, spinning and adding fail (shut_down).
class AGNOCAST_PUBLIC Executor {
 public:
  struct State;  // the library's
  /// Removes its nodes and groups; their messages wait for another executor. Do not destroy it
  /// while it spins.
  virtual ~Executor();
  Executor(const Executor&) = delete;
  Executor& operator=(const Executor&) = delete;

  /// Makes this executor run the callbacks of `node`: of all its groups, existing and future ones,
  /// that are in no executor and are to be added with their node. Unread messages stay unread
  /// until the executor spins. `node`: any object with get_fully_qualified_name(), by reference or
  /// pointer; it is identified by that name alone. Throws Error: invalid_argument (it is in an
  /// executor already), os_failure.
  template <class Node>
  void add_node(Node&& node, [[maybe_unused]] bool notify = true) {
    static_assert(!detail::is_rclcpp_node<detail::NodeOf<Node>>,
                  "agnocast: the callbacks of an rclcpp node run in rclcpp's executors");
    add_node_of_name(detail::dereference(node).get_fully_qualified_name());
  }
  /// A running callback ends where it is; no other one begins. Throws Error: invalid_argument (it
  /// is not in this executor).
  template <class Node>
  void remove_node(Node&& node, [[maybe_unused]] bool notify = true) {
    static_assert(!detail::is_rclcpp_node<detail::NodeOf<Node>>,
                  "agnocast: the callbacks of an rclcpp node run in rclcpp's executors");
    remove_node_of_name(detail::dereference(node).get_fully_qualified_name());
  }

  /// The same for one group, wherever the rest of its node is. Throws Error: invalid_argument (it
  /// is in an executor already), os_failure.
  void add_callback_group(const CallbackGroup::SharedPtr& group);
  /// Throws Error: invalid_argument (it is not in this executor).
  void remove_callback_group(const CallbackGroup::SharedPtr& group);

  /// Runs callbacks until cancel(). All spin functions throw what callbacks throw, and Error
  /// (invalid_argument) if this executor is already spinning, also when called from a callback.
  virtual void spin();
  /// Runs one executor cycle: at most one callback of each subscription that has a message now.
  /// This and the functions below run callbacks in the calling thread alone, in any executor.
  /// Begins none after `max_duration` (0: no bound). Does not wait.
  void spin_some(std::chrono::nanoseconds max_duration = std::chrono::nanoseconds(0));
  /// Runs cycles until nothing is left, or `max_duration` is over (0: no bound).
  void spin_all(std::chrono::nanoseconds max_duration);
  /// Runs at most one callback; waits `timeout` for it (negative: until there is one, or
  /// cancel()).
  void spin_once(std::chrono::nanoseconds timeout = std::chrono::nanoseconds(-1));
  /// Runs callbacks until `future` is ready. Checks it after each callback, and every 10 ms
  /// because another thread may fulfil it.
  template <class Future>
  FutureReturnCode spin_until_future_complete(
      const Future& future, std::chrono::nanoseconds timeout = std::chrono::nanoseconds(-1)) {
    return spin_until(
        [](const void* waited) {
          return static_cast<const Future*>(waited)->wait_for(std::chrono::seconds(0)) ==
                 std::future_status::ready;
        },
        &future, timeout);
  }

  /// Ends the running spin function, or else the next one, so that a cancel before the thread
  /// begins to spin is not lost. For the same reason, a spin function that is just ending by
  /// itself (spin_once(), spin_some(), dispatch(), an exception) leaves the cancel to the next
  /// one. Any thread, any signal handler.
  void cancel() noexcept;
  bool is_spinning() const noexcept;

  // --- an event loop of the user instead of spinning: see docs/nodes.md

  enum class Readiness { work_ready, armed };
  /// Returns a descriptor for poll(), select() or epoll. It becomes readable when something
  /// arrives after prepare() returned `armed`, and once a second: if a publisher dies between
  /// publishing and waking its subscribers while the daemon is down, nobody wakes them. Never read
  /// from it. Constant for the executor's life.
  int fd() const noexcept;
  /// Returns `work_ready`: call dispatch(); or `armed`: wait for fd(), then call dispatch().
  Readiness prepare() noexcept;
  /// Clears what woke this executor and runs one cycle. Returns the number of callbacks. Never
  /// waits.
  std::size_t dispatch();

 protected:
  /// Throws Error: os_failure.
  explicit Executor(std::chrono::nanoseconds spin_budget);
  class Spinning;
  explicit Executor(std::unique_ptr<State> state) noexcept;
  State& state() const noexcept { return *state_; }

 private:
  void add_node_of_name(const std::string& node);
  void remove_node_of_name(const std::string& node);
  FutureReturnCode spin_until(bool (*is_ready)(const void*), const void* future,
                              std::chrono::nanoseconds timeout);
  bool wait_for_work(std::chrono::steady_clock::time_point deadline);

  State* const state_;  // owned; left alone where its threads may still be in there
};

/// Sleeps when there is nothing to do. Waking it costs one system call; none while it is awake.
class AGNOCAST_PUBLIC SingleThreadedExecutor : public Executor {
 public:
  SingleThreadedExecutor() : Executor(std::chrono::nanoseconds(0)) {}
};

/// Polls for `spin_budget` after the last callback before it sleeps: a message that arrives in
/// that time needs no system call on either side. Uses a whole core while it polls.
class AGNOCAST_PUBLIC SpinningExecutor : public Executor {
 public:
  /// Never sleep in spin().
  static constexpr std::chrono::nanoseconds forever = std::chrono::nanoseconds::max();
  explicit SpinningExecutor(std::chrono::nanoseconds spin_budget = std::chrono::microseconds(50))
      : Executor(spin_budget) {}
};

/// spin() runs callbacks in several threads: those of different groups, and of a reentrant group,
/// at the same time.
class AGNOCAST_PUBLIC MultiThreadedExecutor : public Executor {
 public:
  /// `threads`: with the one that calls spin(); 0: as many as processors, at least 2.
  explicit MultiThreadedExecutor(std::size_t threads = 0);
  std::size_t get_number_of_threads() const noexcept { return threads_; }
  /// Its threads live as long as the call. The first exception of a callback ends all and leaves
  /// it. Throws Error: os_failure (a thread cannot be started).
  void spin() override;

 private:
  const std::size_t threads_;
};

/// spin() runs each callback group in a thread of its own, which the group has as long as it is in
/// the executor: a callback waits for those of its own group alone. In a reentrant group, too,
/// they run one at a time.
class AGNOCAST_PUBLIC CallbackIsolatedExecutor : public Executor {
 public:
  CallbackIsolatedExecutor();
  ~CallbackIsolatedExecutor() override;
  /// Throws as that of MultiThreadedExecutor.
  void spin() override;
};

/// Runs callbacks in a library thread, from its construction to its destruction or cancel(). It
/// cannot be spun (invalid_argument). Signals, exceptions and pthread_exit() in callbacks:
/// docs/nodes.md.
class AGNOCAST_PUBLIC BackgroundExecutor : public Executor {
 public:
  /// Throws Error: os_failure (no thread can be started).
  BackgroundExecutor();
  /// Waits for a running callback, unless it is called inside one, or that one waits for this
  /// thread.
  ~BackgroundExecutor() override;
};

/// Runs the callbacks of `node` in this thread, for ever or until one throws.
template <class Node>
void spin(Node&& node) {
  SingleThreadedExecutor executor;
  executor.add_node(node);
  executor.spin();
}

}  // namespace agnocast
