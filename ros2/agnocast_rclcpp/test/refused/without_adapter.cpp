// SPDX-License-Identifier: Apache-2.0
//
// Each case is refused, because this file does not include the adapter.
#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>

#include <rclcpp/rclcpp.hpp>
#include <std_msgs/msg/string.hpp>
#include <std_srvs/srv/trigger.hpp>

#include <chrono>
#include <memory>

using String = std_msgs::msg::String;
using Trigger = std_srvs::srv::Trigger;

void create(const rclcpp::Node::SharedPtr& node) {
#if defined(REFUSED_publisher)
  agnocast::create_publisher<String>(node, "topic", rclcpp::QoS(10));
#elif defined(REFUSED_subscription)
  agnocast::create_subscription<String>(*node, "topic", 10,
                                        [](const agnocast::ipc_shared_ptr<const String>&) {});
#elif defined(REFUSED_polling)
  agnocast::create_subscription<String>(node.get(), "topic", 10);
#elif defined(REFUSED_generic)
  agnocast::create_generic_publisher(node, "topic", "std_msgs/msg/String", rclcpp::QoS(10));
#elif defined(REFUSED_service)
  agnocast::create_service<Trigger>(node, "service",
                                    [](const agnocast::ipc_shared_ptr<const Trigger::Request>&,
                                       agnocast::ipc_shared_ptr<Trigger::Response>&) {});
#elif defined(REFUSED_client)
  agnocast::create_client<Trigger>(node, "service");
#elif defined(REFUSED_executor)
  agnocast::SingleThreadedExecutor().add_node(node);
#elif defined(REFUSED_base_interface)
  agnocast::SingleThreadedExecutor().add_node(node->get_node_base_interface());
#elif defined(REFUSED_group)
  agnocast::create_callback_group(node, agnocast::CallbackGroupType::Reentrant);
#elif defined(REFUSED_timer)
  agnocast::create_wall_timer(node, std::chrono::seconds(1), [] {});
#endif
}
