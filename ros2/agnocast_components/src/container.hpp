// SPDX-License-Identifier: Apache-2.0
//
// Component containers: the node that loads components, in the executor that runs them.
#pragma once

#include <agnocast/agnocast.hpp>

#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/component_manager.hpp>

#include <cstdio>
#include <exception>
#include <memory>
#include <utility>

namespace agnocast_components {

/// Runs a container until rclcpp::shutdown(). `make_executor(node)` reads its parameters from
/// `node`. Returns the exit status.
template <class MakeExecutor>
int run_container(int argc, char** argv, MakeExecutor make_executor) {
  // Outlives what is thrown: the code and the type of an exception may be in a component's library.
  std::shared_ptr<rclcpp_components::ComponentManager> manager;
  try {
    rclcpp::init(argc, argv);
    manager = std::make_shared<rclcpp_components::ComponentManager>(
        std::weak_ptr<rclcpp::Executor>(), "ComponentManager",
        rclcpp::NodeOptions()
            .allow_undeclared_parameters(true)
            .automatically_declare_parameters_from_overrides(true));
    const std::shared_ptr<rclcpp::Executor> executor = make_executor(*manager);
    manager->set_executor(executor);
    executor->add_node(manager);
    executor->spin();
    manager.reset();  // with its components, before the executor
    rclcpp::shutdown();
  } catch (const std::exception& error) {
    std::fprintf(stderr, "component container: %s\n", error.what());
    return 1;
  }
  return 0;
}

}  // namespace agnocast_components
