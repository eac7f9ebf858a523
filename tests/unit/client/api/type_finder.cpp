// SPDX-License-Identifier: Apache-2.0
//
// Looks for one message type in directories and prints the result: a process that links no message
// package, and whose environment a test chooses.
//
//   type_finder [--then COMMAND] NAME [DIRECTORY…]
//
// --then: if the type is not found, runs COMMAND and looks a second time.

#include <agnocast/generic.hpp>

#include <cstdio>
#include <cstdlib>
#include <string>
#include <string_view>
#include <vector>

int main(int argc, char** argv) {
  const char* command = nullptr;
  if (argc > 2 && std::string_view(argv[1]) == "--then") {
    command = argv[2];
    argv += 2;
    argc -= 2;
  }
  if (argc < 2) return 2;
  const std::vector<std::string> paths(argv + 2, argv + argc);
  auto type = agnocast::try_find_message_type(argv[1], paths);
  if (!type && command != nullptr) {
    std::printf("%s\n", agnocast::text_of(type.error()).c_str());
    if (std::system(command) != 0) return 2;
    type = agnocast::try_find_message_type(argv[1], paths);
  }
  if (!type) {
    std::printf("%s\n", agnocast::text_of(type.error()).c_str());
    return 1;
  }
  const auto made = type->make();  // checks that its code can run
  std::printf("%s, %u members\n", type->members().message_name_, type->members().member_count_);
  return 0;
}
