// SPDX-License-Identifier: Apache-2.0

#include "talker.hpp"

#include <rclcpp_components/register_node_macro.hpp>

Talker::Talker(const rclcpp::NodeOptions& options) : Node("talker", options) {
  publisher_ = agnocast::create_publisher<std_msgs::msg::String>(this, "chatter", 1);
  timer_ = create_wall_timer(std::chrono::milliseconds(20), [this] {
    agnocast::ipc_shared_ptr<std_msgs::msg::String> message = publisher_->borrow_loaned_message();
    message->data = std::string(100000, '.');
    publisher_->publish(std::move(message));
    ++count_;
  });
}

RCLCPP_COMPONENTS_REGISTER_NODE(Talker)
