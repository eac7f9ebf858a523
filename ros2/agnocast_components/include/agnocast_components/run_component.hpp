// SPDX-License-Identifier: Apache-2.0
//
// The programs that agnocast_components_register_node() makes.
#pragma once

#include <agnocast/agnocast.hpp>

#include <class_loader/class_loader.hpp>
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/node_factory.hpp>

#include <algorithm>
#include <exception>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace agnocast_components {

/// Makes the node of class `plugin`, which `library` registers, and runs its callbacks until
/// rclcpp::shutdown(). Returns the exit status of the program.
template <class Executor>
int run_component(int argc, char** argv, const std::string& library, const std::string& plugin) {
  const std::vector<std::string> arguments = rclcpp::init_and_remove_ros_arguments(argc, argv);
  int status = 0;
  // Outlives what is thrown: the code and the type of an exception may be in the library.
  std::unique_ptr<class_loader::ClassLoader> loader;
  try {
    loader = std::make_unique<class_loader::ClassLoader>(library);
    const std::string name = "rclcpp_components::NodeFactoryTemplate<" + plugin + ">";
    const auto names = loader->getAvailableClasses<rclcpp_components::NodeFactory>();
    if (std::find(names.begin(), names.end(), name) == names.end())
      throw std::runtime_error("the library " + library + " registers no node of class " + plugin);
    const auto factory = loader->createInstance<rclcpp_components::NodeFactory>(name);
    auto node = factory->create_node_instance(rclcpp::NodeOptions().arguments(arguments));
    Executor executor;
    executor.add_node(node.get_node_base_interface());
    executor.spin();
    executor.remove_node(node.get_node_base_interface());
  } catch (const std::exception& error) {
    RCLCPP_FATAL(rclcpp::get_logger("agnocast_components"), "%s: %s", plugin.c_str(), error.what());
    status = 1;
  }
  rclcpp::shutdown();
  return status;
}

}  // namespace agnocast_components
