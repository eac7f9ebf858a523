// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/agnocast_executor.hpp>
#include <agnocast_rclcpp/repaired_executor.hpp>

#include <rclcpp/executors/single_threaded_executor.hpp>

namespace agnocast {

/// rclcpp's, of which every function may be used.
class SingleThreadedAgnocastExecutor
    : public agnocast_rclcpp::RepairedExecutor<rclcpp::executors::SingleThreadedExecutor> {
 public:
  /// `next_exec_timeout_ms` has no effect: nothing is polled.
  explicit SingleThreadedAgnocastExecutor(
      const rclcpp::ExecutorOptions& options = rclcpp::ExecutorOptions(),
      [[maybe_unused]] int next_exec_timeout_ms = 50)
      : RepairedExecutor(options) {}

  /// The same as add_callback_group().
  void dedicate_to_callback_group(
      const rclcpp::CallbackGroup::SharedPtr& group,
      const rclcpp::node_interfaces::NodeBaseInterface::SharedPtr& node) {
    add_callback_group(group, node);
  }
};

}  // namespace agnocast
