// SPDX-License-Identifier: Apache-2.0
//
// A component over agnocast_rclcpp, beside those that are written for the kernel-module system.

#include <agnocast_rclcpp/agnocast_rclcpp.hpp>

#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>
#include <std_msgs/msg/string.hpp>

class AdapterListener : public rclcpp::Node {
 public:
  explicit AdapterListener(const rclcpp::NodeOptions& options) : Node("adapter_listener", options) {
    using std_msgs::msg::String;
    subscription_ = agnocast::create_subscription<String>(
        this, "chatter", 1, [this](const agnocast::ipc_shared_ptr<const String>& message) {
          if (message->data.size() == 100000) RCLCPP_INFO(get_logger(), "heard %d", ++heard_);
        });
  }

 private:
  int heard_ = 0;
  agnocast::Subscription<std_msgs::msg::String>::SharedPtr subscription_;
};

RCLCPP_COMPONENTS_REGISTER_NODE(AdapterListener)
