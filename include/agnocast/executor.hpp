// SPDX-License-Identifier: Apache-2.0
//
// Executors: threads of the user's own that run the callbacks of nodes. Without one, a library
// thread per node does. Which thread runs what, and what may block: docs/nodes.md.
#pragma once

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

/// What the kinds of executors have in common. One thread at a time spins (or prepares and
/// dispatches); everything else may be called from any thread. Callbacks of one node never run at
/// the same time, and an executor runs one callback at a time.
///
/// An exception that leaves a callback leaves the spin function as well; the executor can be spun
/// again, and the message of that callback counts as delivered.
///
/// In a forked child that has not called exec nothing can be spun or added (shut_down).
class AGNOCAST_PUBLIC Executor {
 public:
  /// Nodes that are still there are run by the library again. Not while it spins.
  virtual ~Executor();
  Executor(const Executor&) = delete;
  Executor& operator=(const Executor&) = delete;

  /// From now on this executor runs the callbacks of `node`: those that it has and those that it
  /// will get. What is unread stays unread until the executor spins; a callback that runs in another
  /// thread at this moment ends there, and none begins meanwhile. `node`: anything with
  /// get_fully_qualified_name(), by reference or pointer; it is known by that name alone.
  /// Throws Error: invalid_argument (it is in an executor already), os_failure.
  template <class Node>
  void add_node(Node&& node, [[maybe_unused]] bool notify = true) {
    add_node_of_name(detail::dereference(node).get_fully_qualified_name());
  }
  /// The library's thread runs its callbacks again. Throws Error: invalid_argument (it is not in
  /// this executor), os_failure.
  template <class Node>
  void remove_node(Node&& node, [[maybe_unused]] bool notify = true) {
    remove_node_of_name(detail::dereference(node).get_fully_qualified_name());
  }

  /// Runs callbacks until cancel(). All spin functions throw what callbacks throw, and Error
  /// (invalid_argument) when this executor is spinning already, also from inside a callback.
  void spin();
  /// One turn: at most one callback of each subscription that has something now, none begun after
  /// `max_duration` (0: no bound). Does not wait.
  void spin_some(std::chrono::nanoseconds max_duration = std::chrono::nanoseconds(0));
  /// Turns until there is nothing left, or `max_duration` is over (0: no bound).
  void spin_all(std::chrono::nanoseconds max_duration);
  /// At most one callback; waits `timeout` for it (negative: until there is one, or cancel()).
  void spin_once(std::chrono::nanoseconds timeout = std::chrono::nanoseconds(-1));
  /// Runs callbacks until `future` is ready. It is looked at after each callback, and every 10 ms
  /// (somebody else may fulfil it).
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

  /// Ends the spin function that runs, or else the next one (so a cancel that comes before its
  /// thread has begun to spin is not lost). One that does its last callback at that moment and ends
  /// by itself (spin_once(), spin_some(), dispatch(), an exception) leaves it to the next one, for
  /// the same reason. Any thread, any signal handler.
  void cancel() noexcept;
  bool is_spinning() const noexcept;

  // --- a loop of one's own, instead of spinning: docs/nodes.md has the loop

  enum class Readiness { work_ready, armed };
  /// For poll(), select() or an epoll set, to be read: readable when something came after prepare()
  /// has said `armed`, and once a second (nobody rings for a publisher that dies between committing
  /// and ringing while the daemon is down as well). Never read from it. The same for the executor's life.
  int fd() const noexcept;
  /// `work_ready`: call dispatch(). `armed`: nothing to do now; wait for fd(), then call dispatch().
  Readiness prepare() noexcept;
  /// Takes note of what rang, and runs one turn. The number of callbacks. Never waits.
  std::size_t dispatch();

 protected:
  /// Throws Error: os_failure.
  explicit Executor(std::chrono::nanoseconds spin_budget);

 private:
  struct State;
  class Spinning;
  void add_node_of_name(const std::string& node);
  void remove_node_of_name(const std::string& node);
  FutureReturnCode spin_until(bool (*is_ready)(const void*), const void* future,
                              std::chrono::nanoseconds timeout);
  bool wait_for_work(std::chrono::steady_clock::time_point deadline);

  std::unique_ptr<State> state_;
};

/// Sleeps when there is nothing to do. One system call to wake it, none while it is awake.
class AGNOCAST_PUBLIC SingleThreadedExecutor : public Executor {
 public:
  SingleThreadedExecutor() : Executor(std::chrono::nanoseconds(0)) {}
};

/// Looks again and again for `spin_budget` after the last callback before it sleeps: a message that
/// comes in that time is taken without any system call, on either side. Costs a whole core while it
/// looks.
class AGNOCAST_PUBLIC SpinningExecutor : public Executor {
 public:
  /// It never sleeps in spin().
  static constexpr std::chrono::nanoseconds forever = std::chrono::nanoseconds::max();
  explicit SpinningExecutor(std::chrono::nanoseconds spin_budget = std::chrono::microseconds(50))
      : Executor(spin_budget) {}
};

/// Runs the callbacks of `node` in this thread, for ever or until one throws.
template <class Node>
void spin(Node&& node) {
  SingleThreadedExecutor executor;
  executor.add_node(node);
  executor.spin();
}

}  // namespace agnocast
