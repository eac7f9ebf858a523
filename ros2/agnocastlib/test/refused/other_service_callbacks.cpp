// SPDX-License-Identifier: Apache-2.0
#include <agnocast/agnocast.hpp>
#include <std_srvs/srv/trigger.hpp>

using Trigger = std_srvs::srv::Trigger;

auto create(rclcpp::Node* node) {
  return agnocast::create_service<Trigger>(
      node, "service", [](Trigger::Request::SharedPtr, Trigger::Response::SharedPtr) {});
}
