// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <bench/system.hpp>

#include <vector>

namespace agnocast::bench::ros2 {

/// Returns all that the case ros2 compares: our own executor, and what needs rclcpp.
const std::vector<System>& systems();

}  // namespace agnocast::bench::ros2
