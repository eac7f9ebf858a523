// SPDX-License-Identifier: Apache-2.0
//
// Goal: which socket, which domain and which form of output a command line means, whatever the order
// of its words. Method: command lines against a table of commands of this test's own; that a new row
// is all a command needs is shown by having one. The texts of errors are in ctl_test.cpp.

#include <ctl/commands.hpp>
#include <ctl/console.hpp>

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace agnocast::ctl {
namespace {

Outcome<void> nothing_done(const Arguments&, Console&) { return {}; }
constexpr Command commands[] = {
    {"thing", "list", "things", domains | types | verbose, nothing_done, "agnocast-ctl thing list"},
    {"thing", "info", "one", a_name | domain, nothing_done, "agnocast-ctl thing info x"},
    {"process", "list", "many", nothing, nothing_done, "agnocast-ctl process list"},
    {"alone", "", "no verb", nothing, nothing_done, "agnocast-ctl alone"},
    {"diary", "", "what was", records, nothing_done, "agnocast-ctl diary"},
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
  EXPECT_EQ(parsed({"thing", "info", "x"}).name, "x");
  EXPECT_EQ(parsed({"-j", "--socket", "/s", "thing", "--domain", "3", "info", "x"}).name, "x");
  EXPECT_EQ(parsed({"alone"}).command, &commands[3]);
  EXPECT_EQ(status_of({"alone", "again"}), Status::wrong_usage);
  EXPECT_EQ(status_of({"thing", "info"}), Status::wrong_usage);
  EXPECT_EQ(status_of({"thing", "info", "x", "y"}), Status::wrong_usage);
}

TEST(Arguments, ChooseTheRecords) {
  EXPECT_EQ(parsed({"diary"}).number, 20u);
  EXPECT_FALSE(parsed({"diary"}).follow);
  const Arguments all =
      parsed({"-n", "7", "--topic", "/points", "diary", "--process", "lidar", "--follow"});
  EXPECT_EQ(all.command, &commands[4]) << "a value is no noun";
  EXPECT_EQ(all.number, 7u);
  EXPECT_EQ(all.topic, "/points");
  EXPECT_EQ(all.process, "lidar");
  EXPECT_TRUE(all.follow);
  EXPECT_EQ(parsed({"diary", "--number=3"}).number, 3u);
  for (const char* const wrong : {"0", "-1", "x", ""})
    EXPECT_EQ(status_of({"diary", "-n", wrong}), Status::wrong_usage) << wrong;
  EXPECT_EQ(status_of({"alone", "-n", "1"}), Status::wrong_usage);
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
  EXPECT_EQ(status_of({"alone"}, around), Status::done) << "it needs none";
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
  EXPECT_TRUE(parsed({"things", "-tvj"}).types);
}

TEST(Console, WritesNumbersForPeople) {
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
