// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/node/tf2/buffer.hpp>

#include <tf2_ros/transform_listener.h>
#include <tf2_ros/qos.hpp>

namespace agnocast {

/// tf2_ros's, for an agnocast::Node.
class TransformListener : public tf2_ros::TransformListener {
 public:
  explicit TransformListener(tf2::BufferCore& buffer, bool spin_thread = true)
      : tf2_ros::TransformListener(buffer, spin_thread) {}
  TransformListener(tf2::BufferCore& buffer, Node& node, bool spin_thread = true,
                    const rclcpp::QoS& qos = tf2_ros::DynamicListenerQoS(),
                    const rclcpp::QoS& static_qos = tf2_ros::StaticListenerQoS())
      : tf2_ros::TransformListener(buffer, &node, spin_thread, qos, static_qos) {}
  TransformListener(tf2::BufferCore& buffer, Node& node, bool spin_thread, const rclcpp::QoS& qos,
                    const rclcpp::QoS& static_qos, const SubscriptionOptions& options,
                    const SubscriptionOptions& static_options)
      : tf2_ros::TransformListener(buffer, &node, spin_thread, qos, static_qos, to_rclcpp(options),
                                   to_rclcpp(static_options)) {}

 private:
  static rclcpp::SubscriptionOptions to_rclcpp(const SubscriptionOptions& options) {
    rclcpp::SubscriptionOptions ros;
    ros.callback_group = options.callback_group;
    ros.ignore_local_publications = options.ignore_local_publications;
    ros.qos_overriding_options = options.qos_overriding_options;
    return ros;
  }
};

}  // namespace agnocast
