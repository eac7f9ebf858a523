// SPDX-License-Identifier: Apache-2.0
//
// Every executor of rclcpp's runs the callbacks of both kinds.
#pragma once

#include <rclcpp/executor.hpp>

namespace agnocast {

using AgnocastExecutor = rclcpp::Executor;

}  // namespace agnocast
