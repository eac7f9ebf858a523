// SPDX-License-Identifier: Apache-2.0
//
// A component for components_test: publishes on "/out_0" to "/out_9", by its name, what it hears on
// "/in". One topic would be full: a user has at most 192 publishers on it. And one with endpoints
// of rclcpp alone, to compare with.

#include <agnocast_rclcpp/agnocast_rclcpp.hpp>

#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>
#include <std_msgs/msg/string.hpp>

#include <cstddef>
#include <functional>
#include <string>
#include <utility>

namespace agnocast_rclcpp {

class Relay : public rclcpp::Node {
 public:
  explicit Relay(const rclcpp::NodeOptions& options) : Node("relay", options) {
    using std_msgs::msg::String;
    const std::size_t topic = std::hash<std::string>()(get_name()) % 10;
    // Humble's own executors fail when a component with a second group is unloaded.
    group_ = create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
    rclcpp::SubscriptionOptions in_group;
    in_group.callback_group = group_;
    publisher_ = agnocast::create_publisher<String>(this, "/out_" + std::to_string(topic), 10);
    subscription_ = agnocast::create_subscription<String>(
        this, "/in", 10,
        [this](const agnocast::ipc_shared_ptr<const String>& heard) {
          auto loan = publisher_->borrow_loaned_message();
          loan->data = heard->data;
          (void)publisher_->publish(std::move(loan));
        },
        in_group);
  }

 private:
  rclcpp::CallbackGroup::SharedPtr group_;
  agnocast::Publisher<std_msgs::msg::String>::SharedPtr publisher_;
  agnocast::Subscription<std_msgs::msg::String>::SharedPtr subscription_;
};

class PlainRelay : public rclcpp::Node {
 public:
  explicit PlainRelay(const rclcpp::NodeOptions& options) : Node("relay", options) {
    using std_msgs::msg::String;
    group_ = create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
    rclcpp::SubscriptionOptions in_group;
    in_group.callback_group = group_;
    publisher_ = create_publisher<String>("/plain_out", 10);
    subscription_ = create_subscription<String>(
        "/plain_in", 10, [this](const String& heard) { publisher_->publish(heard); }, in_group);
  }

 private:
  rclcpp::CallbackGroup::SharedPtr group_;
  rclcpp::Publisher<std_msgs::msg::String>::SharedPtr publisher_;
  rclcpp::Subscription<std_msgs::msg::String>::SharedPtr subscription_;
};

}  // namespace agnocast_rclcpp

RCLCPP_COMPONENTS_REGISTER_NODE(agnocast_rclcpp::PlainRelay)
RCLCPP_COMPONENTS_REGISTER_NODE(agnocast_rclcpp::Relay)
