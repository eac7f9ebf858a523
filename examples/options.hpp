// SPDX-License-Identifier: Apache-2.0
//
// Command line of the examples: --topic, --count, --rate, --verbose and the options of each
// program. Wrong usage exits with status 2. Also ends a subscriber after --count messages or by a
// signal, and lets it print its result in both cases.
#pragma once

#include <agnocast/executor.hpp>
#include <agnocast/node.hpp>

#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

namespace example {

struct Options {
  std::string topic;
  std::uint64_t count = 0;  // messages; 0 = for ever
  double rate = 1.0;        // per second
  std::uint64_t points = 10000;
  std::uint64_t depth = 10;
  std::string scan;
  std::uint64_t fields = 0;  // of a point of the scan; 0 = determined by the file's size
  bool verbose = false;
};

// The most points whose bytes a PointCloud2 can count.
inline constexpr std::uint64_t points_max = UINT32_MAX / (5 * sizeof(float));

[[noreturn]] inline void help(const char* program, const char* topic, const char* extra) {
  std::printf(
      "usage: %s [--topic NAME] [--count N] [--rate HZ] [--depth N] [--verbose]%s [--ros-args -r "
      "FROM:=TO …]\n"
      "  --topic NAME   topic (default %s)\n"
      "  --count N      end after N messages (default: never)\n"
      "  --rate HZ      messages per second, publishers only (default 1)\n"
      "  --depth N      history depth (default 10)\n"
      "  --verbose      a line for each message\n",
      program, extra, topic);
  if (std::strstr(extra, "--points") != nullptr)
    std::fputs("  --points N     points of each cloud (default 10000)\n", stdout);
  if (std::strstr(extra, "--scan") != nullptr) {
    std::fputs(
        "  --scan FILE    replay the points of this file again and again: float32 x y z intensity "
        "ring\n"
        "  --fields N     fields of each of its points: 3, 4 (KITTI) or 5 (nuScenes); default: 4 "
        "or 5, as the size of the file fits\n",
        stdout);
  }
  std::exit(0);
}

/// Parses the command line; ROS arguments apply to nodes created later. `extra`: further options
/// of this program, for the usage line.
inline Options parse(int argc, char** argv, const char* topic, const char* extra = "") {
  const char* const slash = std::strrchr(argv[0], '/');
  const char* const program = slash != nullptr ? slash + 1 : argv[0];
  const auto refuse = [&](const std::string& what, const std::string& why) {
    std::fprintf(stderr, "%s: %s: %s\nhint: %s --help\n", program, what.c_str(), why.c_str(),
                 program);
    std::exit(2);
  };
  Options options;
  options.topic = topic;
  agnocast::init(argc, argv);
  const std::vector<std::string> own = agnocast::remove_ros_arguments(argc, argv);
  for (std::size_t i = 1; i < own.size(); ++i) {
    const std::string& name = own[i];
    if (name == "--help" || name == "-h") help(program, topic, extra);
    if (name == "--verbose") {
      options.verbose = true;
      continue;
    }
    const char* const value = i + 1 < own.size() ? own[++i].c_str() : nullptr;
    char* end = nullptr;
    const bool has_points = std::strstr(extra, "--points") != nullptr,
               has_scan = std::strstr(extra, "--scan") != nullptr;
    const bool known = name == "--topic" || name == "--count" || name == "--rate" ||
                       name == "--depth" || (name == "--points" && has_points) ||
                       ((name == "--scan" || name == "--fields") && has_scan);
    if (!known) refuse(name, "unknown option");
    if (value == nullptr) refuse(name, "needs a value");
    if (name == "--topic") {
      options.topic = value;
    } else if (name == "--count") {
      options.count = std::strtoull(value, &end, 10);
    } else if (name == "--rate") {
      options.rate = std::strtod(value, &end);
    } else if (name == "--depth") {
      options.depth = std::strtoull(value, &end, 10);
    } else if (name == "--fields") {
      options.fields = std::strtoull(value, &end, 10);
      if (options.fields < 3 || options.fields > 5) refuse(name, "must be 3, 4 or 5");
    } else if (name == "--points") {
      options.points = std::strtoull(value, &end, 10);
    } else {
      options.scan = value;
    }
    if (end != nullptr && (*value == '-' || *end != '\0' || end == value))
      refuse(name, std::string("must be a number, not ") + value);
  }
  if (!(options.rate >= 1e-6 && options.rate <= 1e9))
    refuse("--rate", "must be a number from 0.000001 to 1000000000");
  if (options.points > points_max)
    refuse("--points", "a cloud has at most " + std::to_string(points_max) + " points");
  return options;
}

inline agnocast::SingleThreadedExecutor* spinning = nullptr;

/// Makes SIGINT and SIGTERM end the executor's spin() instead of the process, so that the program
/// can print its result.
inline void end_by_signal(agnocast::SingleThreadedExecutor& executor) {
  spinning = &executor;
  for (const int signal : {SIGINT, SIGTERM}) std::signal(signal, [](int) { spinning->cancel(); });
}

}  // namespace example
