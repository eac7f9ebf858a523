// SPDX-License-Identifier: Apache-2.0
//
// Command line of the demo. Wrong usage ends with status 2.
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

/// Prints what is wrong, or the help, and ends the program where there is nothing else to do.
Options parse(int argc, char** argv);

}  // namespace demo
