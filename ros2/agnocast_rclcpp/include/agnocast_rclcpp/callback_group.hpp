// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/callback_group.hpp>
#include <agnocast/result.hpp>

#include <rclcpp/callback_group.hpp>
#include <rclcpp/node_interfaces/node_base_interface.hpp>
#include <rclcpp/node_interfaces/node_waitables_interface.hpp>

namespace agnocast_rclcpp {

/// Returns the group for callbacks that rclcpp shall run with those of `group` (null: the default
/// group of the node): they exclude each other, or do not, as rclcpp's do. It ends with the last
/// endpoint that has it. Any thread. Errors: shut_down (in a forked child), os_failure. Throws what
/// rclcpp throws: std::runtime_error for a group of another node, RCLError for a context that was
/// shut down.
agnocast::Result<agnocast::CallbackGroup::SharedPtr> adapt_group(
    const rclcpp::node_interfaces::NodeBaseInterface::SharedPtr& node,
    const rclcpp::node_interfaces::NodeWaitablesInterface::SharedPtr& waitables,
    rclcpp::CallbackGroup::SharedPtr group);

}  // namespace agnocast_rclcpp
