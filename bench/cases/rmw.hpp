// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <bench/system.hpp>

#include <vector>

namespace agnocast::bench::rmw {

/// Returns all that the case rmw compares: rclcpp over several rmws.
const std::vector<System>& systems();

}  // namespace agnocast::bench::rmw
