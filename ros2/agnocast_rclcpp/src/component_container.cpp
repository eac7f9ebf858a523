// SPDX-License-Identifier: Apache-2.0
//
// agnocast_component_container: rclcpp's component container with the heap hook linked in, so that
// components may publish without agnocast-run. Components are loaded as into rclcpp's.
//   --executor single | multi | isolated     (default: single)
//   --threads N                              of multi; default: as many as processors

#include <agnocast_rclcpp/repaired_executor.hpp>

#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/component_manager.hpp>
#include <rclcpp_components/component_manager_isolated.hpp>

#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

namespace {

using SingleThreaded = agnocast_rclcpp::RepairedExecutor<rclcpp::executors::SingleThreadedExecutor>;
using MultiThreaded = agnocast_rclcpp::RepairedExecutor<rclcpp::executors::MultiThreadedExecutor>;

/// ComponentManagerIsolated ends each executor by cancel(), and waits for its spin() to begin
/// before that: for ever, once the executor has ended with rclcpp::shutdown(). So this one counts
/// as spinning until it is cancelled.
class Isolated : public SingleThreaded {
 public:
  void spin() override {
    SingleThreaded::spin();
    spinning.store(true);
  }
};

int refuse(const std::string& what) {
  std::fprintf(stderr,
               "agnocast_component_container: %s\n"
               "usage: agnocast_component_container [--executor single|multi|isolated] "
               "[--threads N] [--ros-args …]\n",
               what.c_str());
  return 2;
}

}  // namespace

int main(int argc, char** argv) {
  rclcpp::init(argc, argv);
  const std::vector<std::string> words = rclcpp::remove_ros_arguments(argc, argv);
  std::string kind = "single";
  std::size_t threads = 0;
  for (std::size_t i = 1; i < words.size(); ++i) {
    const bool has_value = i + 1 < words.size();
    if (words[i] == "--executor" && has_value) {
      kind = words[++i];
    } else if (words[i] == "--threads" && has_value) {
      char* end = nullptr;
      threads = std::strtoul(words[++i].c_str(), &end, 10);
      if (*end != '\0' || threads == 0 || threads > 1000)
        return refuse("--threads wants a number from 1 to 1000, not '" + words[i] + "'");
    } else {
      return refuse("unknown argument '" + words[i] + "'");
    }
  }
  std::shared_ptr<rclcpp::Executor> executor = std::make_shared<SingleThreaded>();
  std::shared_ptr<rclcpp_components::ComponentManager> manager;
  if (kind == "multi") {
    executor = std::make_shared<MultiThreaded>(rclcpp::ExecutorOptions(), threads);
    manager = std::make_shared<rclcpp_components::ComponentManager>(executor);
  } else if (kind == "isolated") {
    manager = std::make_shared<rclcpp_components::ComponentManagerIsolated<Isolated>>(executor);
  } else if (kind == "single") {
    manager = std::make_shared<rclcpp_components::ComponentManager>(executor);
  } else {
    return refuse("--executor wants single, multi or isolated, not '" + kind + "'");
  }
  executor->add_node(manager);
  executor->spin();
  rclcpp::shutdown();
}
