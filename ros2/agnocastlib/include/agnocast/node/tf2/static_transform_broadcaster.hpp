// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/node/tf2/buffer.hpp>

#include <tf2_ros/static_transform_broadcaster.h>
#include <tf2_ros/qos.hpp>

namespace agnocast {

/// tf2_ros's, for an agnocast::Node.
class StaticTransformBroadcaster : public tf2_ros::StaticTransformBroadcaster {
 public:
  explicit StaticTransformBroadcaster(Node& node,
                                      const rclcpp::QoS& qos = tf2_ros::StaticBroadcasterQoS())
      : tf2_ros::StaticTransformBroadcaster(&node, qos) {}
  StaticTransformBroadcaster(Node& node, const rclcpp::QoS& qos, const PublisherOptions& options)
      : tf2_ros::StaticTransformBroadcaster(&node, qos, to_rclcpp(options)) {}

 private:
  static rclcpp::PublisherOptions to_rclcpp(const PublisherOptions& options) {
    rclcpp::PublisherOptions ros;
    ros.qos_overriding_options = options.qos_overriding_options;
    // Intra-process communication of Humble keeps no message for late subscriptions.
    ros.use_intra_process_comm = rclcpp::IntraProcessSetting::Disable;
    return ros;
  }
};

}  // namespace agnocast
