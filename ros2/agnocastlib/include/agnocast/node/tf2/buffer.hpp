// SPDX-License-Identifier: Apache-2.0
//
// Transforms are those of tf2_ros, which must be linked: they travel as rclcpp's messages do.
#pragma once

#include <agnocast/node/agnocast_node.hpp>

#include <tf2_ros/buffer.h>

namespace agnocast {

using Buffer = tf2_ros::Buffer;

}  // namespace agnocast
