// SPDX-License-Identifier: Apache-2.0
//
// Systems that need rclcpp. This program is built before anything that needs it, so their
// processes are those of agnocast_bench_ros2, which the package agnocast_rclcpp installs
// (ros2/agnocast_rclcpp/bench/) and which has their makers under the same names.
#pragma once

#include <bench/system.hpp>

#include <string>
#include <vector>

namespace agnocast::bench {

std::vector<System> ros2_systems();
/// rclcpp over several rmws.
std::vector<System> rmw_systems();

/// Starts agnocast_bench_ros2 once. Returns what it was built with ("rclcpp 16.0.11, …"); empty,
/// after leave_out() with the reason and the remedy, if it is not found or does not start here.
std::string ros2_versions();

}  // namespace agnocast::bench
