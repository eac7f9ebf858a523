// SPDX-License-Identifier: Apache-2.0
//
// Looks for one message type in directories and prints the result: a process that links no message
// package, and whose environment a test chooses.
//
//   type_finder NAME [DIRECTORY…]

#include <agnocast/generic.hpp>

#include <cstdio>
#include <string>
#include <vector>

int main(int argc, char** argv) {
  if (argc < 2) return 2;
  const std::vector<std::string> paths(argv + 2, argv + argc);
  const auto type = agnocast::try_find_message_type(argv[1], paths);
  if (!type) {
    std::printf("%s\n", agnocast::text_of(type.error()).c_str());
    return 1;
  }
  const auto made = type->make();  // checks that its code can run
  std::printf("%s, %u members\n", type->members().message_name_, type->members().member_count_);
  return 0;
}
