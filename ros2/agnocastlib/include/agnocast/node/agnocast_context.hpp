// SPDX-License-Identifier: Apache-2.0
//
// The life of the process: rclcpp's, because nodes of this package are rclcpp's.
#pragma once

namespace agnocast {

/// Calls rclcpp::init(argc, argv) unless that has been done. Throws what it throws.
void init(int argc, char const* const* argv);
/// Returns whether init() or rclcpp::init() was called, and no shutdown since.
bool ok();
/// Calls rclcpp::shutdown().
void shutdown();

}  // namespace agnocast
