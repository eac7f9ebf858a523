// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/node/tf2/buffer.hpp>

#include <tf2_ros/transform_broadcaster.h>
#include <tf2_ros/qos.hpp>

namespace agnocast {

/// tf2_ros's, for an agnocast::Node.
class TransformBroadcaster : public tf2_ros::TransformBroadcaster {
 public:
  explicit TransformBroadcaster(Node& node,
                                const rclcpp::QoS& qos = tf2_ros::DynamicBroadcasterQoS())
      : tf2_ros::TransformBroadcaster(&node, qos) {}
  TransformBroadcaster(Node& node, const rclcpp::QoS& qos, const PublisherOptions& options)
      : tf2_ros::TransformBroadcaster(&node, qos, to_rclcpp(options)) {}

 private:
  static rclcpp::PublisherOptions to_rclcpp(const PublisherOptions& options) {
    rclcpp::PublisherOptions ros;
    ros.qos_overriding_options = options.qos_overriding_options;
    return ros;
  }
};

}  // namespace agnocast
