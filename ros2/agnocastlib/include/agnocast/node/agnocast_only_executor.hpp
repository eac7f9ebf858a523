// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <rclcpp/executor.hpp>

#include <memory>
#include <vector>

namespace agnocast {

class Node;

/// The common part of the executors for agnocast::Node. They are rclcpp's, and end at
/// rclcpp::shutdown(), so also at SIGINT and SIGTERM.
class AgnocastOnlyExecutor {
 public:
  virtual ~AgnocastOnlyExecutor();
  AgnocastOnlyExecutor(const AgnocastOnlyExecutor&) = delete;
  AgnocastOnlyExecutor& operator=(const AgnocastOnlyExecutor&) = delete;

  /// The functions are those of rclcpp::Executor.
  virtual void spin();
  virtual void cancel();

  void add_node(rclcpp::node_interfaces::NodeBaseInterface::SharedPtr node_ptr, bool notify = true);
  void add_node(const std::shared_ptr<agnocast::Node>& node, bool notify = true);
  void remove_node(rclcpp::node_interfaces::NodeBaseInterface::SharedPtr node_ptr,
                   bool notify = true);
  void remove_node(const std::shared_ptr<agnocast::Node>& node, bool notify = true);
  void add_callback_group(rclcpp::CallbackGroup::SharedPtr group_ptr,
                          rclcpp::node_interfaces::NodeBaseInterface::SharedPtr node_ptr,
                          bool notify = true);
  void remove_callback_group(rclcpp::CallbackGroup::SharedPtr group_ptr, bool notify = true);
  std::vector<rclcpp::CallbackGroup::WeakPtr> get_all_callback_groups();
  std::vector<rclcpp::CallbackGroup::WeakPtr> get_manually_added_callback_groups();
  std::vector<rclcpp::CallbackGroup::WeakPtr> get_automatically_added_callback_groups_from_nodes();

 protected:
  explicit AgnocastOnlyExecutor(std::unique_ptr<rclcpp::Executor> executor);
  rclcpp::Executor& executor() const noexcept { return *executor_; }

 private:
  const std::unique_ptr<rclcpp::Executor> executor_;
};

}  // namespace agnocast
