// SPDX-License-Identifier: Apache-2.0
//
// Goal: completion offers what fits at the cursor, and manual pages agree with --help. Method: the
// real table of commands, with names of this test; each typed word in turn.

#include <agnocast/error.hpp>
#include <ctl/cli/help.hpp>
#include <ctl/cli/manual.hpp>
#include <ctl/commands/completion.hpp>

#include <gmock/gmock.h>

#include <algorithm>
#include <string>
#include <vector>

namespace agnocast::ctl {
namespace {

using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using Words = std::vector<std::string>;

Words names(Names kind) {
  switch (kind) {
    case Names::topics:
      return {"/points", "/points_raw", "/clock", "/bad name", "/$(id)",
              "/`id`",   "/a;b",        "/*",     "/\x1b"};
    case Names::nodes:
      return {"/lidar"};
    case Names::processes:
      return {"4711"};
    default:
      return {};
  }
}
Words offered(const Words& words) { return completions_of(words, all_commands, names); }

TEST(Completion, OffersNounsThenVerbsThenNames) {
  EXPECT_THAT(offered({"to"}), ElementsAre("top", "topic"));
  EXPECT_THAT(offered({"topic", "h"}), ElementsAre("hz"));
  EXPECT_THAT(offered({"topic", "info", "/po"}), ElementsAre("/points", "/points_raw"));
  EXPECT_THAT(offered({"topic", "info", ""}), ElementsAre("/clock", "/points", "/points_raw"))
      << "completion must offer no text that a shell would interpret";
  EXPECT_THAT(offered({"topic", "info", "/points", ""}), IsEmpty())
      << "the command takes one topic";
  EXPECT_THAT(offered({"topic", "hz", "/clock", "/p"}), ElementsAre("/points", "/points_raw"));
  EXPECT_THAT(offered({"node", "info", ""}), ElementsAre("/lidar"));
  EXPECT_THAT(offered({"topics", ""}), IsEmpty());
  EXPECT_THAT(offered({"nonsense", ""}), IsEmpty());
  EXPECT_THAT(offered({}), IsEmpty());
}

TEST(Completion, OffersOptionsOfTheCommandAndTheirValues) {
  EXPECT_THAT(offered({"topic", "list", "--s"}), ElementsAre("--show-types", "--socket"));
  EXPECT_THAT(offered({"topic", "info", "-v", "/c"}), ElementsAre("/clock"));
  EXPECT_THAT(offered({"graph", "--format", ""}), ElementsAre("dot", "mermaid"));
  EXPECT_THAT(offered({"journal", "--topic", "/cl"}), ElementsAre("/clock"));
  EXPECT_THAT(offered({"monitor", "--process", ""}), ElementsAre("4711"));
  EXPECT_THAT(offered({"--socket", "/x", "topic", "ty"}), ElementsAre("type"));
  EXPECT_THAT(offered({"topic", "hz", "-w", ""}), IsEmpty()) << "a number has no completion";
  EXPECT_THAT(offered({"topic", "info", "--", "-"}), IsEmpty());
}

TEST(Completion, OffersEveryCommand) {
  for (const Command& command : all_commands) {
    EXPECT_THAT(offered({""}), Contains(std::string(command.noun)));
    if (command.verb.empty()) continue;
    EXPECT_THAT(offered({std::string(command.noun), ""}), Contains(std::string(command.verb)));
  }
}

TEST(Manual, HasASectionForEachCommandThatAgreesWithHelp) {
  const std::string page = manual_of(all_commands, "November 21, 2026");
  for (const Command& command : all_commands) {
    const std::size_t at = page.find(".Ss " + usage_of(command) + "\\&\n");
    ASSERT_NE(at, std::string::npos) << full_name(command);
    const std::string section = page.substr(at, page.find(".Ss ", at + 1) - at);
    std::string flowing = section;
    std::replace(flowing.begin(), flowing.end(), '\n', ' ');
    for (const Option* const option : command.options)
      EXPECT_THAT(flowing, HasSubstr(meaning_of(*option))) << full_name(command);
    EXPECT_THAT(section, HasSubstr(".Dl agnocast-ctl ")) << full_name(command);
  }
}

TEST(Manual, HasEveryCode) {
  const std::string page = manual_of_errors("November 21, 2026");
  for (int number = 1; *remedy_of(static_cast<Errc>(number)) != '\0'; ++number)
    EXPECT_THAT(page,
                HasSubstr(".It Er " + std::string(word_of(static_cast<Errc>(number))) + "\n"));
}

}  // namespace
}  // namespace agnocast::ctl
