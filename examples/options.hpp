// SPDX-License-Identifier: Apache-2.0
//
// Command line of the examples: --topic, --count, --rate, --verbose and what each adds. Wrong usage ends with status 2.
#pragma once

#include <agnocast/node.hpp>

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
  bool verbose = false;
};

[[noreturn]] inline void usage(const char* program, const char* topic, const char* extra, int status, const char* what = "") {
  std::FILE* const out = status == 0 ? stdout : stderr;
  if (status != 0) std::fprintf(out, "%s: %s\n", program, what);
  std::fprintf(out,
               "usage: %s [--topic NAME] [--count N] [--rate HZ] [--depth N] [--verbose]%s [--ros-args -r FROM:=TO …]\n"
               "  --topic NAME   topic (default %s)\n"
               "  --count N      end after N messages (default: go on)\n"
               "  --rate HZ      messages per second, publishers only (default 1)\n"
               "  --depth N      history depth (default 10)\n"
               "  --verbose      a line for each message\n",
               program, extra, topic);
  if (std::strstr(extra, "--points") != nullptr) std::fputs("  --points N     points of each cloud (default 10000)\n", out);
  if (std::strstr(extra, "--scan") != nullptr) std::fputs("  --scan FILE    the points are this file's: float32 x y z intensity ring, again and again\n", out);
  std::exit(status);
}

/// ROS arguments are for the nodes that are created later. `extra`: options of this program beyond the common ones, for the usage line.
inline Options parse(int argc, char** argv, const char* topic, const char* extra = "") {
  const char* const slash = std::strrchr(argv[0], '/');
  const char* const program = slash != nullptr ? slash + 1 : argv[0];
  const auto refuse = [&](const std::string& what) { usage(program, topic, extra, 2, what.c_str()); };
  Options options;
  options.topic = topic;
  agnocast::init(argc, argv);
  const std::vector<std::string> own = agnocast::remove_ros_arguments(argc, argv);
  for (std::size_t i = 1; i < own.size(); ++i) {
    const std::string& name = own[i];
    if (name == "--help" || name == "-h") usage(program, topic, extra, 0);
    if (name == "--verbose") {
      options.verbose = true;
      continue;
    }
    if (i + 1 == own.size()) refuse(name + " needs a value, or is unknown");
    const char* const value = own[++i].c_str();
    char* end = nullptr;
    if (name == "--topic") {
      options.topic = value;
    } else if (name == "--count") {
      options.count = std::strtoull(value, &end, 10);
    } else if (name == "--rate") {
      options.rate = std::strtod(value, &end);
    } else if (name == "--depth") {
      options.depth = std::strtoull(value, &end, 10);
    } else if (name == "--points" && std::strstr(extra, "--points") != nullptr) {
      options.points = std::strtoull(value, &end, 10);
    } else if (name == "--scan" && std::strstr(extra, "--scan") != nullptr) {
      options.scan = value;
    } else {
      refuse(name + " is unknown");
    }
    if (end != nullptr && (*value == '-' || *end != '\0' || end == value)) refuse(name + " wants a number, not " + value);
  }
  if (!(options.rate >= 1e-6 && options.rate <= 1e9)) refuse("--rate wants a number above 0");
  return options;
}

}  // namespace example
