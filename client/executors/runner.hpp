// SPDX-License-Identifier: Apache-2.0
//
// Runner: the callbacks of one node as long as the node has any, and the library thread that runs
// them while no executor does.
//
// Runners and the claims of executors are found by the node's fully qualified name: a node may be
// added to an executor before or after its first subscription, and any type of node fits. All
// changes of executor go through here, under one mutex, so that a node has one executor at any
// time. The thread is made when it is first needed; while a user's executor runs the callbacks,
// it waits.
#pragma once

#include <agnocast/result.hpp>
#include <client/executors/node_callbacks.hpp>
#include <client/executors/node_thread.hpp>

#include <memory>
#include <string>
#include <utility>

namespace agnocast {

class ExecutorCore;

class Runner {
 public:
  /// Returns the runner of the node with this fully qualified name; made with its first
  /// subscription, destroyed with its last. Errors: limit_reached (all wait sets of the process
  /// are in use), os_failure, and those of connecting.
  [[nodiscard]] static Result<std::shared_ptr<Runner>> of_node(const std::string& node);
  ~Runner();
  Runner(const Runner&) = delete;
  Runner& operator=(const Runner&) = delete;

  NodeCallbacks& callbacks() const noexcept { return *callbacks_; }
  const std::shared_ptr<WaitSet>& wait_set() const noexcept { return callbacks_->wait_set(); }

  /// Makes `executor` run the callbacks of this node, present and future ones. Errors:
  /// invalid_argument (an executor has it already), os_failure.
  [[nodiscard]] static Result<void> claim(const std::string& node, ExecutorCore& executor);
  /// Returns them to the library's thread. Errors: invalid_argument (it is not this executor's),
  /// os_failure (no thread can be made).
  [[nodiscard]] static Result<void> release(const std::string& node, ExecutorCore& executor);
  /// Releases all nodes of an executor that ends.
  static void release_all(ExecutorCore& executor) noexcept;

 private:
  explicit Runner(std::shared_ptr<NodeCallbacks> callbacks) noexcept
      : callbacks_(std::move(callbacks)) {}
  Result<void> run_by_thread();

  // Both shared with the thread: the last subscription may be destroyed inside its own callback.
  const std::shared_ptr<NodeCallbacks> callbacks_;
  std::shared_ptr<NodeThread> thread_;  // null: not needed yet
};

}  // namespace agnocast
