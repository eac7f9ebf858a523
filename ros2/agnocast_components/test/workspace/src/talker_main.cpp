// SPDX-License-Identifier: Apache-2.0

#include "talker.hpp"

int main(int argc, char** argv) {
  rclcpp::init(argc, argv);
  agnocast::SingleThreadedAgnocastExecutor executor;
  auto node = std::make_shared<Talker>(rclcpp::NodeOptions());
  executor.add_node(node);
  executor.spin();
  rclcpp::shutdown();
  return 0;
}
