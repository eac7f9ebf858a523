// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "agnocast/agnocast.hpp"
#include "rclcpp/rclcpp.hpp"
#include "std_msgs/msg/string.hpp"

class Talker : public rclcpp::Node {
 public:
  explicit Talker(const rclcpp::NodeOptions& options);

 private:
  int count_ = 0;
  agnocast::Publisher<std_msgs::msg::String>::SharedPtr publisher_;
  rclcpp::TimerBase::SharedPtr timer_;
};
