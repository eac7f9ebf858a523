// SPDX-License-Identifier: Apache-2.0

#include "agnocast/agnocast.hpp"
#include "rclcpp/rclcpp.hpp"
#include "std_msgs/msg/string.hpp"

#include <rclcpp_components/register_node_macro.hpp>

using std::placeholders::_1;

class Listener : public rclcpp::Node {
 public:
  explicit Listener(const rclcpp::NodeOptions& options) : Node("listener", options) {
    agnocast::SubscriptionOptions agnocast_options;
    agnocast_options.callback_group =
        create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
    group_ = agnocast_options.callback_group;
    subscription_ = agnocast::create_subscription<std_msgs::msg::String>(
        this, "chatter", 1, std::bind(&Listener::callback, this, _1), agnocast_options);
  }

 private:
  void callback(const agnocast::ipc_shared_ptr<std_msgs::msg::String>& message) {
    if (message->data.size() == 100000) RCLCPP_INFO(get_logger(), "heard %d", ++heard_);
  }

  int heard_ = 0;
  rclcpp::CallbackGroup::SharedPtr group_;
  agnocast::Subscription<std_msgs::msg::String>::SharedPtr subscription_;
};

RCLCPP_COMPONENTS_REGISTER_NODE(Listener)
