// SPDX-License-Identifier: Apache-2.0
//
// Runner: the callbacks of one node for as long as anything of the node has callbacks, and the
// library thread that runs them while no executor does.
//
// Runners are found by the node's fully qualified name, and so are the claims of executors: a node
// may be added to an executor before or after its first subscription, and any type of node fits. All
// changes of host go through here, under one mutex, so that a node has one host at any time. The
// thread is made when it is needed first; while an executor is the host it waits.
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
  /// The one of the node with this fully qualified name; made with its first subscription, gone
  /// with its last. Errors: limit_reached (every sleeper of the process is in use), os_failure, and
  /// those of connecting.
  [[nodiscard]] static Result<std::shared_ptr<Runner>> of_node(const std::string& node);
  ~Runner();
  Runner(const Runner&) = delete;
  Runner& operator=(const Runner&) = delete;

  NodeCallbacks& callbacks() const noexcept { return *callbacks_; }
  const std::shared_ptr<Sleeper>& sleeper() const noexcept { return callbacks_->sleeper(); }

  /// The callbacks of this node are run by `executor`, those of today and those to come. Errors:
  /// invalid_argument (an executor has it already), os_failure.
  [[nodiscard]] static Result<void> claim(const std::string& node, ExecutorCore& executor);
  /// They are run by the library's thread again. Errors: invalid_argument (it is not this
  /// executor's), os_failure (no thread can be made).
  [[nodiscard]] static Result<void> release(const std::string& node, ExecutorCore& executor);
  /// All nodes of an executor that goes.
  static void release_all(ExecutorCore& executor) noexcept;

 private:
  explicit Runner(std::shared_ptr<NodeCallbacks> callbacks) noexcept
      : callbacks_(std::move(callbacks)) {}
  Result<void> host_by_thread();

  // Both shared with the thread: the last subscription may go inside its own callback.
  const std::shared_ptr<NodeCallbacks> callbacks_;
  std::shared_ptr<NodeThread> thread_;  // null: none was needed yet
};

}  // namespace agnocast
