// SPDX-License-Identifier: Apache-2.0
//
// agnocast_component_container_mt: components in several threads. Parameters:
// number_of_ros2_threads and number_of_agnocast_threads (their sum counts; 0: half of the
// processors), yield_before_execute, ros2_next_exec_timeout_ms.

#include "container.hpp"

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>

int main(int argc, char** argv) {
  return agnocast_components::run_container(argc, argv, [](rclcpp::Node& node) {
    const auto threads = [&](const char* name) {
      return static_cast<std::size_t>(
          std::max<std::int64_t>(node.get_parameter_or<std::int64_t>(name, 0), 0));
    };
    const auto timeout_ms = node.get_parameter_or<std::int64_t>("ros2_next_exec_timeout_ms", -1);
    return std::make_shared<agnocast::MultiThreadedAgnocastExecutor>(
        rclcpp::ExecutorOptions(), threads("number_of_ros2_threads"),
        threads("number_of_agnocast_threads"), node.get_parameter_or("yield_before_execute", false),
        timeout_ms < 0 ? std::chrono::nanoseconds(-1)
                       : std::chrono::nanoseconds(std::chrono::milliseconds(timeout_ms)));
  });
}
