// SPDX-License-Identifier: Apache-2.0
//
// Publishers, subscriptions, services and clients for rclcpp nodes. Include this instead of
// <agnocast/agnocast.hpp>; the functions are the same, with rclcpp's QoS, options and callback
// groups, and the callbacks run where rclcpp runs those of the node:
//
//   subscription_ = agnocast::create_subscription<sensor_msgs::msg::PointCloud2>(
//       this, "points", rclcpp::SensorDataQoS(),
//       [this](const agnocast::ipc_shared_ptr<const sensor_msgs::msg::PointCloud2>& cloud) { … });
//
// See docs/ros2.md.
#pragma once

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>
#include <agnocast/generic_service.hpp>
#include <agnocast_rclcpp/node_adapter.hpp>
