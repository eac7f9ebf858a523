// SPDX-License-Identifier: Apache-2.0

#include <examples/demo/options.hpp>

#include <cstdio>
#include <cstdlib>

namespace demo {
namespace {

constexpr const char* help =
    "usage: scripts/demo [--quick] [--seconds N] [--no-dds]\n"
    "  PointCloud2 of 1 KB to 8 MB from a publisher process to two subscriber processes that\n"
    "  check every member of every message; proof that no byte moved; latencies beside the\n"
    "  same message through Cyclone DDS. Ends with status 0 only if every message was intact.\n"
    "  --quick        a few seconds: fewer messages, one round of measurements\n"
    "  --seconds N    time for measuring latencies (1 to 600, default 40)\n"
    "  --no-dds       without the comparison\n"
    "  --help         this text\n"
    "for tests:\n"
    "  --corrupt-one  the publisher changes one byte of one message; the demo must fail\n"
    "  --agnocastd FILE, --hook FILE   daemon and heap hook of a build tree\n";

[[noreturn]] void refuse(const std::string& what) {
  std::fprintf(stderr, "demo: %s\nhint: scripts/demo --help\n", what.c_str());
  std::exit(2);
}

}  // namespace

Options parse(int argc, char** argv) {
  Options options;
  for (int i = 1; i < argc; ++i) {
    const std::string name = argv[i];
    const auto value = [&] {
      if (i + 1 == argc) refuse(name + " needs a value");
      return std::string(argv[++i]);
    };
    if (name == "--help" || name == "-h") {
      std::fputs(help, stdout);
      std::exit(0);
    } else if (name == "--quick") {
      options.seconds = 3;
      options.rounds = 1;
      options.clouds_per_size = 10;
    } else if (name == "--seconds") {
      const std::string text = value();
      char* end = nullptr;
      options.seconds = std::strtod(text.c_str(), &end);
      if (end == text.c_str() || *end != '\0' || !(options.seconds >= 1 && options.seconds <= 600))
        refuse("--seconds needs a number from 1 to 600, not " + text);
    } else if (name == "--no-dds") {
      options.with_dds = false;
    } else if (name == "--corrupt-one") {
      options.corrupt_one = true;
    } else if (name == "--agnocastd") {
      options.daemon = value();
    } else if (name == "--hook") {
      options.hook = value();
    } else {
      refuse("unknown option " + name);
    }
  }
  return options;
}

}  // namespace demo
