// SPDX-License-Identifier: Apache-2.0
//
// Goal: a command line selects the right socket, domain and output format in any order of its
// words. Method: command lines against this test's own table of commands; having a new row shows
// that a row is all a command needs. ctl_test.cpp checks the texts of errors.

#include <ctl/cli/commands.hpp>
#include <ctl/cli/console.hpp>

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace agnocast::ctl {
namespace {

Outcome<void> nothing_done(const Arguments&, Console&) { return {}; }
namespace o = options;
constexpr Subject things{"THINGS", "each", Names::topics, Subject::Count::many};
constexpr Subject value{"VALUE", "what to give", Names::none, Subject::Count::optional};
constexpr Option rate{"-r,--rate", "a second", Option::Kind::real, "HZ", "1", 0, 1000};
constexpr Option colour{"--colour", "of it", Option::Kind::word, "WORD", {}, 0, 0, "red green"};
constexpr Command commands[] = {
    {"thing",
     "list",
     "things",
     {},
     these<o::domain, o::all_domains, o::show_types, o::verbose>,
     nothing_done,
     "",
     "agnocast-ctl thing list"},
    {"thing", "info", "one", about<subjects::topic>, these<o::domain>, nothing_done, "",
     "agnocast-ctl thing info x"},
    {"process", "list", "many", {}, {}, nothing_done, "", "agnocast-ctl process list"},
    {"alone", "", "no verb", {}, {}, nothing_done, "", "agnocast-ctl alone"},
    {"diary",
     "",
     "what was",
     {},
     these<o::records, o::of_topic, o::of_process, o::follow>,
     nothing_done,
     "",
     "agnocast-ctl diary"},
    {"thing", "paint", "them", about<things>, these<rate, colour>, nothing_done, "",
     "agnocast-ctl thing paint a"},
    {"thing", "give", "it", about<subjects::topic, value>, these<rate>, nothing_done, "",
     "agnocast-ctl thing give a b"},
};

Arguments parsed(const std::vector<std::string>& words, const Surroundings& around = {}) {
  auto result = parse_arguments(words, commands, around);
  if (!result) {
    ADD_FAILURE() << result.error().what << ": " << result.error().why;
    return {};
  }
  return std::get<Arguments>(*result);
}
Status status_of(const std::vector<std::string>& words, const Surroundings& around = {}) {
  const auto result = parse_arguments(words, commands, around);
  return result ? Status::done : result.error().status;
}

TEST(Arguments, ChooseTheCommand) {
  EXPECT_EQ(parsed({"thing", "list"}).command, &commands[0]);
  EXPECT_EQ(parsed({"things"}).command, &commands[0]);
  EXPECT_EQ(parsed({"processes", "-j"}).command, &commands[2]);
  EXPECT_EQ(parsed({"thing", "info", "x"}).subject(0), "x");
  EXPECT_EQ(parsed({"-j", "--socket", "/s", "thing", "--domain", "3", "info", "x"}).subject(0),
            "x");
  EXPECT_EQ(parsed({"alone"}).command, &commands[3]);
  EXPECT_EQ(status_of({"alone", "again"}), Status::wrong_usage);
  EXPECT_EQ(status_of({"thing", "info"}), Status::wrong_usage);
  EXPECT_EQ(status_of({"thing", "info", "x", "y"}), Status::wrong_usage);
}

TEST(Arguments, ChooseTheRecords) {
  EXPECT_EQ(parsed({"diary"}).whole(o::records), 20u);
  EXPECT_FALSE(parsed({"diary"}).has(o::follow));
  const Arguments all =
      parsed({"-n", "7", "--topic", "/points", "diary", "--process", "lidar", "--follow"});
  EXPECT_EQ(all.command, &commands[4]) << "the value of an option is not a noun";
  EXPECT_EQ(all.whole(o::records), 7u);
  EXPECT_EQ(all.text(o::of_topic), "/points");
  EXPECT_EQ(all.text(o::of_process), "lidar");
  EXPECT_TRUE(all.has(o::follow));
  EXPECT_EQ(parsed({"diary", "--number=3"}).whole(o::records), 3u);
  for (const char* const wrong : {"0", "-1", "x", ""})
    EXPECT_EQ(status_of({"diary", "-n", wrong}), Status::wrong_usage) << wrong;
  EXPECT_EQ(status_of({"alone", "-n", "1"}), Status::wrong_usage);
}

TEST(Arguments, MustBeAsManyAsTheCommandTakes) {
  EXPECT_EQ(parsed({"thing", "paint", "a", "b"}).subjects, (std::vector<std::string>{"a", "b"}));
  EXPECT_EQ(status_of({"thing", "paint"}), Status::wrong_usage);
  EXPECT_EQ(parsed({"thing", "give", "a"}).subject(1), "");
  EXPECT_EQ(parsed({"thing", "give", "a", "b"}).subject(1), "b");
  EXPECT_EQ(parsed({"thing", "give", "a", "--", "-1"}).subject(1), "-1")
      << "words after -- are not options";
  EXPECT_EQ(status_of({"thing", "give", "a", "b", "c"}), Status::wrong_usage);
  EXPECT_EQ(status_of({"thing", "give", ""}), Status::wrong_usage);
}

TEST(Arguments, AreCheckedAgainstTheRulesOfTheirOption) {
  const auto paint = [](const std::string& option, const std::string& what) {
    return std::vector<std::string>{"thing", "paint", "a", option, what};
  };
  EXPECT_EQ(parsed({"thing", "paint", "a"}).real(rate), 1.0);
  EXPECT_EQ(parsed(paint("-r", "2.5")).real(rate), 2.5);
  EXPECT_EQ(parsed(paint("--colour", "green")).text(colour), "green");
  EXPECT_EQ(parsed({"thing", "paint", "a"}).text(colour), "");
  for (const char* const wrong : {"0", "-1", "1001", "x", "", "nan", "inf", "1 "})
    EXPECT_EQ(status_of(paint("-r", wrong)), Status::wrong_usage) << wrong;
  for (const char* const wrong : {"blue", "", "red green"})
    EXPECT_EQ(status_of(paint("--colour", wrong)), Status::wrong_usage) << wrong;
}

TEST(Arguments, ChooseTheSocket) {
  Surroundings around;
  EXPECT_EQ(parsed({"alone"}, around).socket, "/run/agnocast/agnocastd.sock");
  around.xdg_runtime_dir = "/run/user/1000";
  EXPECT_EQ(parsed({"alone"}, around).socket, "/run/user/1000/agnocast/agnocastd.sock");
  around.has_system_socket = true;
  EXPECT_EQ(parsed({"alone"}, around).socket, "/run/agnocast/agnocastd.sock");
  around.agnocast_socket = "/named";
  EXPECT_EQ(parsed({"alone"}, around).socket, "/named");
  EXPECT_EQ(parsed({"alone", "--socket=/option"}, around).socket, "/option");
}

TEST(Arguments, ChooseTheDomain) {
  Surroundings around;
  EXPECT_EQ(parsed({"things"}, around).domain, 0u);
  around.ros_domain_id = "42";
  EXPECT_EQ(parsed({"things"}, around).domain, 42u);
  EXPECT_EQ(parsed({"things", "--domain", "7"}, around).domain, 7u);
  EXPECT_TRUE(parsed({"things", "-a"}, around).all_domains);
  around.ros_domain_id = "x";
  EXPECT_EQ(status_of({"things"}, around), Status::wrong_usage);
  EXPECT_EQ(status_of({"alone"}, around), Status::done) << "the command needs no domain";
  EXPECT_EQ(status_of({"thing", "info", "x", "--all-domains"}), Status::wrong_usage);
}

TEST(Arguments, ChooseTheFormOfTheOutput) {
  Surroundings terminal;
  terminal.out_is_terminal = true;
  EXPECT_EQ(parsed({"alone"}).json, Json::no);
  EXPECT_EQ(parsed({"alone", "-j"}).json, Json::compact);
  EXPECT_EQ(parsed({"alone", "-j"}, terminal).json, Json::pretty);
  EXPECT_EQ(parsed({"--json", "alone"}).json, Json::compact);
  EXPECT_EQ(parsed({"alone", "--json=short"}, terminal).json, Json::compact);
  EXPECT_EQ(parsed({"alone", "--json=pretty"}).json, Json::pretty);
  EXPECT_EQ(status_of({"alone", "--json=yaml"}), Status::wrong_usage);
  EXPECT_TRUE(parsed({"things", "-tvj"}).has(o::show_types));
}

TEST(Console, WritesReadableNumbers) {
  EXPECT_EQ(bytes_for_people(0), "0 B");
  EXPECT_EQ(bytes_for_people(1023), "1023 B");
  EXPECT_EQ(bytes_for_people(1536), "1.5 KiB");
  EXPECT_EQ(bytes_for_people(std::uint64_t{16} << 30), "16.0 GiB");
  EXPECT_EQ(duration_for_people(999'999'999), "under 1 s");
  EXPECT_EQ(duration_for_people(61'000'000'000), "1 min 1 s");
  EXPECT_EQ(duration_for_people(90'000'000'000'000), "1 d 1 h");
  EXPECT_EQ(counted(1, "message"), "1 message");
  EXPECT_EQ(counted(2, "process", "processes"), "2 processes");
}

}  // namespace
}  // namespace agnocast::ctl
