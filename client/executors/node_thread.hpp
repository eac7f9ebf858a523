// SPDX-License-Identifier: Apache-2.0
//
// NodeThread: the library's thread of one node. It runs the callbacks while it is their executor,
// waits while a user's executor is, and ends with the node's last callback.
//
// A callback may end its thread (pthread_exit). That is a library thread, so the node gets a new
// one, which begins when the first has ended, and the message counts as delivered.
#pragma once

#include <sys/epoll.h>
#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <client/executors/node_callbacks.hpp>
#include <client/executors/sleep_tick.hpp>

#include <memory>
#include <mutex>
#include <thread>
#include <utility>

namespace agnocast {

class NodeThread {
 public:
  /// Starts a thread for `node`, whose address identifies it as executor. Errors: os_failure.
  [[nodiscard]] static Result<std::shared_ptr<NodeThread>> start(
      std::shared_ptr<NodeCallbacks> node);

  NodeThread(std::shared_ptr<NodeCallbacks> node, UniqueFd epoll, SleepTick tick) noexcept
      : node_(std::move(node)), epoll_(std::move(epoll)), tick_(std::move(tick)) {}
  NodeThread(const NodeThread&) = delete;
  NodeThread& operator=(const NodeThread&) = delete;
  ~NodeThread();

  /// Call it after node.stop(): waits until the thread has ended, unless it is this thread or
  /// waits for this one.
  void join() noexcept;
  /// For a forked child: the thread belongs to the parent.
  void abandon() noexcept;

 private:
  struct Life;
  static Result<void> start_next(const std::shared_ptr<NodeThread>& self);
  void run(const std::shared_ptr<NodeThread>& self);
  void serve();
  int sleep(epoll_event (&events)[3]) const;

  const std::shared_ptr<NodeCallbacks> node_;
  const UniqueFd epoll_;  // with the node's doorbells and the tick
  const SleepTick tick_;
  std::mutex mutex_;
  std::thread thread_, before_;  // thread_ waits for before_
  bool is_joined_ = false;       // start no further thread
};

}  // namespace agnocast
