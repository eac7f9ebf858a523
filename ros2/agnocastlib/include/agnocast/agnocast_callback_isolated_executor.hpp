// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/agnocast_executor.hpp>

#include <rclcpp/rclcpp.hpp>

#include <chrono>
#include <memory>
#include <vector>

namespace agnocast {

/// Runs each callback group in a thread of its own: a callback waits for those of its own group
/// alone. In a reentrant group, too, they run one at a time. Nodes and groups may be added and
/// removed at any time; any thread may call any function.
class CallbackIsolatedAgnocastExecutor : public rclcpp::Executor {
 public:
  /// `next_exec_timeout_ms` has no effect: nothing is polled for callbacks. New groups of nodes
  /// are looked for every `monitor_polling_interval_ms`.
  explicit CallbackIsolatedAgnocastExecutor(
      const rclcpp::ExecutorOptions& options = rclcpp::ExecutorOptions(),
      int next_exec_timeout_ms = 50, int monitor_polling_interval_ms = 100);
  /// Do not destroy it while it spins.
  ~CallbackIsolatedAgnocastExecutor() override;

  /// Runs callbacks until cancel() or rclcpp::shutdown(). The first exception of a callback ends
  /// all threads and leaves it. Throws std::runtime_error: it is spinning already.
  void spin() override;
  /// Ends spin(). May be called inside a callback.
  void cancel();

  /// These throw std::runtime_error: the node or group is in an executor (add), or not in this
  /// one (remove). Removing waits for running callbacks, but for the one in which it is called.
  void add_callback_group(rclcpp::CallbackGroup::SharedPtr group_ptr,
                          rclcpp::node_interfaces::NodeBaseInterface::SharedPtr node_ptr,
                          bool notify = true) override;
  void remove_callback_group(rclcpp::CallbackGroup::SharedPtr group_ptr,
                             bool notify = true) override;
  void add_node(rclcpp::node_interfaces::NodeBaseInterface::SharedPtr node_ptr,
                bool notify = true) override;
  void add_node(rclcpp::Node::SharedPtr node_ptr, bool notify = true) override;
  void remove_node(rclcpp::node_interfaces::NodeBaseInterface::SharedPtr node_ptr,
                   bool notify = true) override;
  void remove_node(rclcpp::Node::SharedPtr node_ptr, bool notify = true) override;

  std::vector<rclcpp::CallbackGroup::WeakPtr> get_all_callback_groups() override;
  std::vector<rclcpp::CallbackGroup::WeakPtr> get_manually_added_callback_groups() override;
  std::vector<rclcpp::CallbackGroup::WeakPtr> get_automatically_added_callback_groups_from_nodes()
      override;

  /// They throw std::logic_error: callbacks have threads of their own, so only spin() can run
  /// them.
  void spin_some(std::chrono::nanoseconds max_duration = std::chrono::nanoseconds(0)) override;
  void spin_all(std::chrono::nanoseconds max_duration) override;
  void spin_once(std::chrono::nanoseconds timeout = std::chrono::nanoseconds(-1)) override;

 protected:
  void spin_once_impl(std::chrono::nanoseconds timeout) override;

 private:
  struct State;
  const std::unique_ptr<State> state_;
};

}  // namespace agnocast
