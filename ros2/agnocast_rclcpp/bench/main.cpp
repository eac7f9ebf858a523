// SPDX-License-Identifier: Apache-2.0
//
// agnocast_bench_ros2: the processes of `agnocast-bench ros2`, which starts them as %ROLE
// (bench/process.hpp).
//
// Exit status: 0 done, 1 a failure, 2 wrong usage.

#include <bench/process.hpp>

#include <rclcpp/version.h>
#include <rclcpp/rclcpp.hpp>

#include <cstdio>
#include <exception>
#include <string>
#include <vector>

namespace agnocast::bench {
namespace {

int print_versions(const std::vector<std::string>&) {
#ifdef __OPTIMIZE__
  const char* const doubt = "";
#else
  const char* const doubt = ", without optimisation: its figures have little meaning";
#endif
  std::printf("rclcpp %s%s\n", RCLCPP_VERSION_STR, doubt);
  return 0;
}

const RegisterRole versions("versions", print_versions);

// Signals end the process, as those of agnocast-bench; a file of the log would be one for each.
void init() {
  rclcpp::InitOptions options;
  options.auto_initialize_logging(false);
  rclcpp::init(0, nullptr, options, rclcpp::SignalHandlerOptions::None);
}

}  // namespace
}  // namespace agnocast::bench

int main(int argc, char** argv) {
  const std::vector<std::string> words(argv + 1, argv + argc);
  if (words.empty() || words[0].rfind('%', 0) != 0) {
    std::fputs("agnocast_bench_ros2: only agnocast-bench starts it\nhint: agnocast-bench ros2\n",
               stderr);
    return 2;
  }
  try {
    agnocast::bench::init();
    const int status =
        agnocast::bench::run_role(words[0].substr(1), {words.begin() + 1, words.end()});
    rclcpp::shutdown();
    return status;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "agnocast_bench_ros2: %s\n", error.what());
    return 1;
  }
}
