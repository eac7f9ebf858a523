// SPDX-License-Identifier: Apache-2.0
//
// Goal: ROS arguments mean the same as in ROS 2, and errors name the wrong argument. Method:
// command lines as tables; the rules are those of ROS 2's static remapping article.

#include <client/node/arguments.hpp>

#include <gmock/gmock.h>

#include <string>
#include <vector>

namespace agnocast {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using Line = std::vector<std::string>;

std::vector<RemapRule> rules_of(Line rules) {
  Line line{"--ros-args"};
  for (std::string& rule : rules) {
    line.push_back("-r");
    line.push_back(std::move(rule));
  }
  Result<Arguments> parsed = parse_arguments(line);
  EXPECT_TRUE(parsed) << text_of(parsed.error());
  return parsed ? parsed->rules : std::vector<RemapRule>();
}

std::string error_of(const Line& line) {
  const auto parsed = parse_arguments(line);
  return parsed ? "(no error)" : text_of(parsed.error());
}

/// Returns the name that the node /space/node uses for `name`.
std::string remapped(const Line& rules, const std::string& name,
                     RemapRule::Kind kind = RemapRule::Kind::topic) {
  const auto result = remap(rules_of(rules), kind, name, "node", "/space");
  return result ? *result : std::string("error: ") + text_of(result.error());
}

TEST(Arguments, OnlyWhatFollowsRosArgsIsForRos) {
  const auto parsed = parse_arguments({"program", "-r", "mine:=too", "--ros-args", "--remap",
                                       "a:=b", "--", "own", "--ros-args", "-r", "c:=d"});
  ASSERT_TRUE(parsed);
  EXPECT_THAT(parsed->others, ElementsAre("program", "-r", "mine:=too", "own"));
  ASSERT_EQ(parsed->rules.size(), 2u);
  EXPECT_EQ(parsed->rules[0].from, "a");
  EXPECT_EQ(parsed->rules[1].to, "d");
  EXPECT_TRUE(parse_arguments({}));
  EXPECT_TRUE(parse_arguments({"--ros-args"}));
  EXPECT_TRUE(parse_arguments({"--ros-args", "--", "--"}));
}

TEST(Arguments, FromLaunchFilesAreAccepted) {
  const auto parsed = parse_arguments({"--ros-args", "--params-file", "/some/file.yaml", "-p",
                                       "rate:=10", "--log-level", "info", "-e", "/enclave",
                                       "--disable-rosout-logs", "-r", "a:=b"});
  ASSERT_TRUE(parsed) << text_of(parsed.error());
  EXPECT_EQ(parsed->rules.size(), 1u);
}

TEST(Arguments, WithoutEffectAreListedWithTheirValues) {
  const auto parsed = parse_arguments({"program",
                                       "-p",
                                       "own:=1",
                                       "--ros-args",
                                       "-p",
                                       "rate:=10",
                                       "--param",
                                       "a:=b",
                                       "-r",
                                       "a:=b",
                                       "--params-file",
                                       "/f.yaml",
                                       "-e",
                                       "/enclave",
                                       "--enclave",
                                       "/e",
                                       "--log-level",
                                       "info",
                                       "--log-config-file",
                                       "/l",
                                       "--enable-rosout-logs",
                                       "--disable-rosout-logs",
                                       "--enable-stdout-logs",
                                       "--disable-stdout-logs",
                                       "--enable-external-lib-logs",
                                       "--disable-external-lib-logs",
                                       "--",
                                       "--log-level",
                                       "own"});
  ASSERT_TRUE(parsed) << text_of(parsed.error());
  EXPECT_THAT(parsed->ignored,
              ElementsAre("-p rate:=10", "--param a:=b", "--params-file /f.yaml", "-e /enclave",
                          "--enclave /e", "--log-level info", "--log-config-file /l",
                          "--enable-rosout-logs", "--disable-rosout-logs", "--enable-stdout-logs",
                          "--disable-stdout-logs", "--enable-external-lib-logs",
                          "--disable-external-lib-logs"));
  EXPECT_THAT(rules_of({"a:=b"}), testing::SizeIs(1));
  EXPECT_THAT(parse_arguments({"--ros-args", "-r", "a:=b"})->ignored, testing::IsEmpty());
}

TEST(Arguments, AreNamedWhenTheyAreWrong) {
  const struct {
    const char* rule;
    const char* sentence;
  } table[] = {
      {"nonsense", "\"nonsense\": a remap rule is from:=to"},
      {":=to", "a remap rule is from:=to"},
      {"from:=", "a remap rule is from:=to"},
      {"from:=a b", "right side: a space is not allowed, at character 2"},
      {"fr om:=a", "left side: a space is not allowed, at character 3"},
      {"a//b:=c", "left side: two slashes in a row"},
      {"/*:=c", "left side: only letters"},
      {"__node:=a/b", "right side: the name of a node has no slash"},
      {"__ns:=/a/", "right side: a slash cannot be the last character"},
      {"1node:a:=b", "node: a digit cannot be the first character"},
  };
  for (const auto& row : table)
    EXPECT_THAT(error_of({"--ros-args", "-r", row.rule}), HasSubstr(row.sentence)) << row.rule;
  EXPECT_THAT(error_of({"--ros-args", "-r"}), HasSubstr("\"-r\": its value is missing"));
  EXPECT_THAT(error_of({"--ros-args", "--bogus"}), HasSubstr("\"--bogus\": not an option"));
}

TEST(Arguments, RemapTopicsByTheirFullNamesAndTheFirstRuleWins) {
  EXPECT_EQ(remapped({"points:=cloud"}, "/space/points"), "/space/cloud");
  EXPECT_EQ(remapped({"points:=/cloud"}, "/space/points"), "/cloud");
  EXPECT_EQ(remapped({"/space/points:=cloud"}, "/space/points"), "/space/cloud");
  EXPECT_EQ(remapped({"~/points:=~/cloud"}, "/space/node/points"), "/space/node/cloud");
  EXPECT_EQ(remapped({"points:=cloud"}, "/points"), "/points") << "another topic";
  EXPECT_EQ(remapped({"a:=b", "a:=c"}, "/space/a"), "/space/b");
  EXPECT_EQ(remapped({"a:=b", "b:=c"}, "/space/a"), "/space/b") << "rules do not chain";
  EXPECT_EQ(remapped({"rostopic://a:=b"}, "/space/a"), "/space/b");
  EXPECT_EQ(remapped({"rosservice://a:=b"}, "/space/a"), "/space/a");
}

TEST(Arguments, RemapServicesByAllRulesExceptThoseForTopics) {
  constexpr auto service = RemapRule::Kind::service;
  EXPECT_EQ(remapped({"a:=b"}, "/space/a", service), "/space/b");
  EXPECT_EQ(remapped({"rosservice://a:=b"}, "/space/a", service), "/space/b");
  EXPECT_EQ(remapped({"rostopic://a:=b"}, "/space/a", service), "/space/a");
  EXPECT_EQ(remapped({"rostopic://a:=b", "a:=c"}, "/space/a", service), "/space/c");
}

TEST(Arguments, WithANodesNameApplyToThatNode) {
  EXPECT_EQ(remapped({"node:a:=b"}, "/space/a"), "/space/b");
  EXPECT_EQ(remapped({"other:a:=b", "a:=c"}, "/space/a"), "/space/c");
  const auto rules = rules_of({"other:__node:=x", "node:__node:=y", "__node:=z", "__ns:=deep/er"});
  EXPECT_EQ(find_rule(rules, RemapRule::Kind::node_name, "node")->to, "y");
  EXPECT_EQ(find_rule(rules, RemapRule::Kind::node_name, "third")->to, "z");
  EXPECT_EQ(find_rule(rules, RemapRule::Kind::node_namespace, "node")->to, "/deep/er");
}

}  // namespace
}  // namespace agnocast
