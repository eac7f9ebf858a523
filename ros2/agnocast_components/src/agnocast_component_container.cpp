// SPDX-License-Identifier: Apache-2.0
//
// agnocast_component_container: all components in one thread.

#include "container.hpp"

int main(int argc, char** argv) {
  return agnocast_components::run_container(argc, argv, [](rclcpp::Node&) {
    return std::make_shared<agnocast::SingleThreadedAgnocastExecutor>();
  });
}
