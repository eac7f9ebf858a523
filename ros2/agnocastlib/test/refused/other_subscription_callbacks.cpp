// SPDX-License-Identifier: Apache-2.0
#include <agnocast/agnocast.hpp>
#include <std_msgs/msg/string.hpp>

auto create(rclcpp::Node* node) {
  return agnocast::create_subscription<std_msgs::msg::String>(
      node, "topic", 1, [](std::unique_ptr<std_msgs::msg::String>) {});
}
