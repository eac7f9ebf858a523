// SPDX-License-Identifier: Apache-2.0

#include <bench/systems/ros2.hpp>

#include <bench/environment.hpp>
#include <bench/process.hpp>
#include <bench/services.hpp>
#include <bench/systems/cyclonedds_settings.hpp>

#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>

namespace agnocast::bench {
namespace {

namespace fs = std::filesystem;

/// Returns the path of agnocast_bench_ros2: in a sourced workspace, else in one where it is
/// installed beside this program, merged or not; empty: it is in none of them.
std::string find_program() {
  std::vector<fs::path> prefixes;
  const char* const sourced = std::getenv("AMENT_PREFIX_PATH");
  std::istringstream list(sourced == nullptr ? "" : sourced);
  for (std::string prefix; std::getline(list, prefix, ':');) prefixes.emplace_back(prefix);
  std::error_code ignored;
  const fs::path own = fs::read_symlink("/proc/self/exe", ignored).parent_path().parent_path();
  prefixes.push_back(own);
  prefixes.push_back(own.parent_path() / "agnocast_rclcpp");
  for (const fs::path& prefix : prefixes) {
    const fs::path program = prefix / "lib" / "agnocast_rclcpp" / "agnocast_bench_ros2";
    if (::access(program.c_str(), X_OK) == 0) return program;
  }
  return {};
}

const std::string& program() {
  static const std::string path = find_program();
  return path;
}
std::string program_of_systems() { return program(); }

std::vector<std::string> with(std::vector<std::string> one, const std::vector<std::string>& more) {
  one.insert(one.end(), more.begin(), more.end());
  return one;
}

/// Every node has a DDS participant; where its messages do not go through it, it only finds the
/// others.
std::vector<std::string> nodes() {
  return with(cyclonedds_over_network(),
              {"RMW_IMPLEMENTATION=rmw_cyclonedds_cpp", "ROS_LOCALHOST_ONLY=0"});
}
std::vector<std::string> nodes_tuned() { return with(nodes(), cyclonedds_tuned()); }
std::vector<std::string> nodes_over_iceoryx() {
  return with(cyclonedds_over_iceoryx(),
              {"RMW_IMPLEMENTATION=rmw_cyclonedds_cpp", "ROS_LOCALHOST_ONLY=0"});
}
std::vector<std::string> nodes_over_agnocast() { return {"RMW_IMPLEMENTATION=rmw_agnocast_cpp"}; }
// Without the variable rclcpp takes no loans.
std::vector<std::string> nodes_with_loans() {
  return with(nodes_over_agnocast(), {"LD_PRELOAD=" + path_of("libagnocast_heaphook.so"),
                                      "ROS_DISABLE_LOANED_MESSAGES=0"});
}
std::vector<std::string> nodes_with_hook() {
  return with(nodes(), {"LD_PRELOAD=" + path_of("libagnocast_heaphook.so")});
}

System system(std::string_view name, std::string_view summary, std::string_view service,
              std::vector<std::string> (*environment)(), bool is_one_process = false) {
  return {.name = name,
          .summary = summary,
          .make_sender = nullptr,
          .make_receiver = nullptr,
          .service = service,
          .environment = environment,
          .program = program_of_systems,
          .is_one_process = is_one_process};
}

}  // namespace

std::vector<System> ros2_systems() {
  return {
      system("agnocast-rclcpp", "agnocast_rclcpp in rclcpp's single-threaded executor", "agnocastd",
             nodes_with_hook),
      system("agnocast-rclcpp-static", "the same in the static single-threaded executor",
             "agnocastd", nodes_with_hook),
      system("rclcpp-cyclonedds", "rclcpp over rmw_cyclonedds_cpp, loopback interface, reliable",
             "", nodes),
      system("rclcpp-cyclonedds-tuned", "the same with packets of 64 KB and a large receive buffer",
             "", nodes_tuned),
      system("rclcpp-intra-process", "rclcpp within one process, a unique_ptr that is moved", "",
             nodes, true),
  };
}

std::vector<System> rmw_systems() {
  return {
      system("rclcpp-cyclonedds", "rclcpp over rmw_cyclonedds_cpp, loopback interface, reliable",
             "", nodes),
      system("rclcpp-cyclonedds-iceoryx", "the same through iceoryx' shared memory", "iox-roudi",
             nodes_over_iceoryx),
      system("rclcpp-agnocast", "rclcpp over rmw_agnocast_cpp, without the heap hook", "agnocastd",
             nodes_over_agnocast),
      system("rclcpp-agnocast-loans", "the same with the hook, published and taken as loans",
             "agnocastd", nodes_with_loans),
  };
}

std::string ros2_versions() {
  if (program().empty()) {
    leave_out(
        "systems that need rclcpp are left out: agnocast_bench_ros2 is not found; build the "
        "package agnocast_rclcpp where a ROS 2 is sourced, and source its workspace "
        "(docs/ros2.md)");
    return {};
  }
  const Directory place;
  const std::string file = place.path() + "/output";
  Process process({.command = {program(), "%versions"}, .environment = nodes(), .output = file});
  const auto status = process.wait(std::chrono::minutes(1));
  std::ifstream stream(file);
  std::string text{std::istreambuf_iterator<char>(stream), {}};
  while (text.ends_with('\n')) text.pop_back();
  if (status == 0) return text.substr(text.rfind('\n') + 1);
  leave_out("systems that need rclcpp are left out: " + program() +
            " does not start; source the ROS 2 that it was built with, which needs the package "
            "rmw_cyclonedds_cpp; it wrote: " +
            text);
  return {};
}

}  // namespace agnocast::bench
