// SPDX-License-Identifier: Apache-2.0
#include <agnocast/agnocast.hpp>

void create(agnocast::Node& node) {
  node.create_generic_publisher("topic", "std_msgs/msg/String", rclcpp::QoS(1));
}
