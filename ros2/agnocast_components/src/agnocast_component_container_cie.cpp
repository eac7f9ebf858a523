// SPDX-License-Identifier: Apache-2.0
//
// agnocast_component_container_cie: each callback group of the components in a thread of its own.
// Parameter: monitor_polling_interval_ms, how often new groups are looked for (100).

#include "container.hpp"

int main(int argc, char** argv) {
  return agnocast_components::run_container(argc, argv, [](rclcpp::Node& node) {
    constexpr int unused_timeout_ms = 50;
    return std::make_shared<agnocast::CallbackIsolatedAgnocastExecutor>(
        rclcpp::ExecutorOptions(), unused_timeout_ms,
        static_cast<int>(node.get_parameter_or<std::int64_t>("monitor_polling_interval_ms", 100)));
  });
}
