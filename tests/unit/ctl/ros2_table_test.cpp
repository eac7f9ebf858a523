// SPDX-License-Identifier: Apache-2.0
//
// Goal: the table of ros2's flags in docs/ctl.md is true: a flag called the same exists with that
// spelling, and every other one has a reason. Method: compare it with the table of commands.

#include <ctl/cli/commands.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::ctl {
namespace {

/// Returns the texts between backticks.
std::vector<std::string> in_backticks(std::string_view text) {
  std::vector<std::string> words;
  for (std::size_t at = 0; (at = text.find('`', at)) != std::string_view::npos;) {
    const std::size_t end = text.find('`', at + 1);
    if (end == std::string_view::npos) break;
    words.emplace_back(text.substr(at + 1, end - at - 1));
    at = end + 1;
  }
  return words;
}

bool has_option(const std::string& verb, std::string_view flag) {
  const auto spells = [&](const Option* option) { return spellings_of(*option).has(flag); };
  return std::any_of(all_commands.begin(), all_commands.end(), [&](const Command& command) {
    return std::string(command.noun) + ' ' + std::string(command.verb) == verb &&
           std::any_of(command.options.begin(), command.options.end(), spells);
  });
}

TEST(Ros2Table, IsTrueRowByRow) {
  std::ifstream file(AGNOCAST_SOURCE_DIR "/docs/ctl.md");
  ASSERT_TRUE(file);
  std::string line;
  while (std::getline(file, line) && line != "## Beside ros2's verbs") {
  }
  std::size_t same = 0, others = 0;
  while (std::getline(file, line) && !line.starts_with("## ")) {
    if (!line.starts_with("| `")) continue;
    const std::size_t flags = line.find(" | ") + 3, here = line.find(" | ", flags) + 3;
    ASSERT_LT(here, line.size()) << "a cell is empty: " << line;
    const std::string answer = line.substr(here);
    for (const std::string& verb : in_backticks(line.substr(0, flags))) {
      for (const std::string& flag : in_backticks(line.substr(flags, here - flags))) {
        if (answer.starts_with("same")) {
          EXPECT_TRUE(has_option(verb, flag)) << verb << ' ' << flag;
          ++same;
        } else if (answer.starts_with("none: ")) {
          EXPECT_FALSE(has_option(verb, flag) && flag != "-n" && flag != "-c")
              << verb << ' ' << flag;
          ++others;
        }
      }
    }
  }
  EXPECT_GE(same, 50u);
  EXPECT_GE(others, 5u);
}

}  // namespace
}  // namespace agnocast::ctl
