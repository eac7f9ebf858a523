// SPDX-License-Identifier: Apache-2.0
//
// Command line of the demo. Wrong usage exits with status 2.
#pragma once

#include <string>

namespace demo {

struct Options {
  double seconds = 40;  // for the latencies, all sizes together
  int rounds = 5;
  unsigned clouds_per_size = 40;
  bool with_dds = true;
  bool corrupt_one = false;
  std::string daemon = "agnocastd";
  std::string hook;  // empty: agnocast-run sets the preload
};

/// Prints errors or the help, and exits then.
Options parse(int argc, char** argv);

}  // namespace demo
