// SPDX-License-Identifier: Apache-2.0

#include <agnocast/agnocast_callback_isolated_executor.hpp>
#include <agnocast/agnocast_multi_threaded_executor.hpp>
#include <agnocast/agnocast_single_threaded_executor.hpp>
#include <agnocast/node/agnocast_node.hpp>
#include <agnocast/node/agnocast_only_callback_isolated_executor.hpp>
#include <agnocast/node/agnocast_only_multi_threaded_executor.hpp>
#include <agnocast/node/agnocast_only_single_threaded_executor.hpp>

#include <algorithm>
#include <thread>
#include <utility>

namespace agnocast {
namespace {

std::size_t half_of_processors() {
  return std::max<std::size_t>(std::thread::hardware_concurrency() / 2, 1);
}

}  // namespace

MultiThreadedAgnocastExecutor::MultiThreadedAgnocastExecutor(
    const rclcpp::ExecutorOptions& options, std::size_t number_of_ros2_threads,
    std::size_t number_of_agnocast_threads, bool yield_before_execute,
    std::chrono::nanoseconds ros2_next_exec_timeout, int)
    : RepairedExecutor(
          options,
          (number_of_ros2_threads != 0 ? number_of_ros2_threads : half_of_processors()) +
              (number_of_agnocast_threads != 0 ? number_of_agnocast_threads : half_of_processors()),
          yield_before_execute, ros2_next_exec_timeout) {}

AgnocastOnlyExecutor::AgnocastOnlyExecutor(std::unique_ptr<rclcpp::Executor> executor)
    : executor_(std::move(executor)) {}
AgnocastOnlyExecutor::~AgnocastOnlyExecutor() = default;

void AgnocastOnlyExecutor::spin() { executor_->spin(); }
void AgnocastOnlyExecutor::cancel() { executor_->cancel(); }
void AgnocastOnlyExecutor::add_node(rclcpp::node_interfaces::NodeBaseInterface::SharedPtr node_ptr,
                                    bool notify) {
  executor_->add_node(std::move(node_ptr), notify);
}
void AgnocastOnlyExecutor::add_node(const std::shared_ptr<agnocast::Node>& node, bool notify) {
  executor_->add_node(node->get_node_base_interface(), notify);
}
void AgnocastOnlyExecutor::remove_node(
    rclcpp::node_interfaces::NodeBaseInterface::SharedPtr node_ptr, bool notify) {
  executor_->remove_node(std::move(node_ptr), notify);
}
void AgnocastOnlyExecutor::remove_node(const std::shared_ptr<agnocast::Node>& node, bool notify) {
  executor_->remove_node(node->get_node_base_interface(), notify);
}
void AgnocastOnlyExecutor::add_callback_group(
    rclcpp::CallbackGroup::SharedPtr group_ptr,
    rclcpp::node_interfaces::NodeBaseInterface::SharedPtr node_ptr, bool notify) {
  executor_->add_callback_group(std::move(group_ptr), std::move(node_ptr), notify);
}
void AgnocastOnlyExecutor::remove_callback_group(rclcpp::CallbackGroup::SharedPtr group_ptr,
                                                 bool notify) {
  executor_->remove_callback_group(std::move(group_ptr), notify);
}
std::vector<rclcpp::CallbackGroup::WeakPtr> AgnocastOnlyExecutor::get_all_callback_groups() {
  return executor_->get_all_callback_groups();
}
std::vector<rclcpp::CallbackGroup::WeakPtr>
AgnocastOnlyExecutor::get_manually_added_callback_groups() {
  return executor_->get_manually_added_callback_groups();
}
std::vector<rclcpp::CallbackGroup::WeakPtr>
AgnocastOnlyExecutor::get_automatically_added_callback_groups_from_nodes() {
  return executor_->get_automatically_added_callback_groups_from_nodes();
}

AgnocastOnlySingleThreadedExecutor::AgnocastOnlySingleThreadedExecutor(int)
    : AgnocastOnlyExecutor(std::make_unique<SingleThreadedAgnocastExecutor>()) {}

AgnocastOnlyMultiThreadedExecutor::AgnocastOnlyMultiThreadedExecutor(std::size_t number_of_threads,
                                                                     bool yield_before_execute, int)
    : AgnocastOnlyExecutor(
          std::make_unique<
              agnocast_rclcpp::RepairedExecutor<rclcpp::executors::MultiThreadedExecutor>>(
              rclcpp::ExecutorOptions(), number_of_threads, yield_before_execute)) {}

AgnocastOnlyCallbackIsolatedExecutor::AgnocastOnlyCallbackIsolatedExecutor(int)
    : AgnocastOnlyExecutor(std::make_unique<CallbackIsolatedAgnocastExecutor>()) {}
void AgnocastOnlyCallbackIsolatedExecutor::cancel() {
  static_cast<CallbackIsolatedAgnocastExecutor&>(executor()).cancel();
}

}  // namespace agnocast
