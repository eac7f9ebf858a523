// SPDX-License-Identifier: Apache-2.0
//
// Writes one manual page at build time. Arguments: the page, its date, and the output file.

#include <ctl/cli/manual.hpp>

#include <cstdio>
#include <fstream>
#include <string>

int main(int argc, char** argv) {
  namespace ctl = agnocast::ctl;
  const std::string page = argc == 4 ? argv[1] : "";
  std::string text;
  if (page == "agnocast-ctl.1") text = ctl::manual_of(ctl::all_commands, argv[2]);
  if (page == "agnocast-errors.7") text = ctl::manual_of_errors(argv[2]);
  if (text.empty()) {
    std::fputs("usage: agnocast-manual-pages agnocast-ctl.1|agnocast-errors.7 DATE FILE\n", stderr);
    return 2;
  }
  std::ofstream file(argv[3]);
  return file << text && file.flush() ? 0 : 1;
}
