// SPDX-License-Identifier: Apache-2.0

#include "agnocast/agnocast.hpp"
#include "std_msgs/msg/string.hpp"

#include <rclcpp_components/register_node_macro.hpp>

class OnlyListener : public agnocast::Node {
 public:
  explicit OnlyListener(const rclcpp::NodeOptions& options)
      : agnocast::Node("only_listener", options) {
    subscription_ =
        create_subscription<std_msgs::msg::String>("chatter", rclcpp::QoS(rclcpp::KeepLast(1)));
    timer_ = create_wall_timer(std::chrono::milliseconds(20), [this] {
      const auto message = subscription_->take_data();
      if (message) RCLCPP_INFO(get_logger(), "%s heard %d", get_name().c_str(), ++heard_);
    });
  }

 private:
  int heard_ = 0;
  agnocast::PollingSubscriber<std_msgs::msg::String>::SharedPtr subscription_;
  agnocast::TimerBase::SharedPtr timer_;
};

RCLCPP_COMPONENTS_REGISTER_NODE(OnlyListener)
