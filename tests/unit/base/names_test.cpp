// SPDX-License-Identifier: Apache-2.0
//
// Goal: exactly the names of ROS 2 pass, and every refusal says what is wrong and where. Method:
// tables of good names, bad names with the text a user sees, and expansions.

#include <base/text/names.hpp>

#include <agnocast/abi/wire.hpp>

#include <gtest/gtest.h>

#include <string>

namespace agnocast {
namespace {

static_assert(name_length_max + 1 == abi::wire::name_bytes, "one place for a name on the wire");

using namespace std::string_literals;
using Check = std::optional<NameProblem> (*)(std::string_view) noexcept;

std::string text_of(const std::optional<NameProblem>& problem) {
  return problem ? problem->text() : "good";
}

const std::string longest = "/" + std::string(name_length_max - 1, 'a');

struct Row {
  Check check;
  std::string name;
  const char* text;
};

const Row rows[] = {
    {check_topic_name, "/chatter", "good"},
    {check_topic_name, "/a", "good"},
    {check_topic_name, "/_", "good"},
    {check_topic_name, "/__hidden__/x", "good"},
    {check_topic_name, "/lidar/front/points_2", "good"},
    {check_topic_name, "/A/b9/C_d", "good"},
    {check_topic_name, longest, "good"},
    {check_topic_name, "", "the name is empty, at character 1"},
    {check_topic_name, "chatter", "a fully qualified name starts with a slash, at character 1"},
    {check_topic_name, "~/x", "a fully qualified name starts with a slash, at character 1"},
    {check_topic_name, "/", "a slash cannot be the last character, at character 1"},
    {check_topic_name, "/a/", "a slash cannot be the last character, at character 3"},
    {check_topic_name, "//a", "two slashes in a row, at character 2"},
    {check_topic_name, "/a//b", "two slashes in a row, at character 4"},
    {check_topic_name, "//", "two slashes in a row, at character 2"},
    {check_topic_name, "/9", "a digit cannot be the first character of a token, at character 2"},
    {check_topic_name, "/a/2b", "a digit cannot be the first character of a token, at character 4"},
    {check_topic_name, "/a b", "a space is not allowed, at character 3"},
    {check_topic_name, "/a-b",
     "only letters, digits, underscores and slashes are allowed, at character 3"},
    {check_topic_name, "/a.b",
     "only letters, digits, underscores and slashes are allowed, at character 3"},
    {check_topic_name, "/a\n",
     "only letters, digits, underscores and slashes are allowed, at character 3"},
    {check_topic_name, "/\xc3\xa4",
     "only letters, digits, underscores and slashes are allowed, at character 2"},
    {check_topic_name, "/a\0b"s, "a zero byte is not allowed, at character 3"},
    {check_topic_name, "/a/~", "a tilde can only be the first character, at character 4"},
    {check_topic_name, "/{node}/x", "substitutions in braces are not supported, at character 2"},
    {check_topic_name, "/a}", "substitutions in braces are not supported, at character 3"},
    {check_topic_name, longest + "a", "the name is longer than 255 characters, at character 256"},

    {check_node_name, "talker", "good"},
    {check_node_name, "_ros2cli_daemon_0", "good"},
    {check_node_name, "A1", "good"},
    {check_node_name, std::string(255, 'n'), "good"},
    {check_node_name, "", "the name is empty, at character 1"},
    {check_node_name, "1a", "a digit cannot be the first character of a token, at character 1"},
    {check_node_name, "a/b", "the name of a node has no slash, at character 2"},
    {check_node_name, "/a", "the name of a node has no slash, at character 1"},
    {check_node_name, "a-b",
     "only letters, digits, underscores and slashes are allowed, at character 2"},
    {check_node_name, std::string(256, 'n'),
     "the name is longer than 255 characters, at character 256"},

    {check_namespace, "/", "good"},
    {check_namespace, "/robot", "good"},
    {check_namespace, "/robot/left_arm", "good"},
    {check_namespace, "", "the name is empty, at character 1"},
    {check_namespace, "robot", "a fully qualified name starts with a slash, at character 1"},
    {check_namespace, "/robot/", "a slash cannot be the last character, at character 7"},
    {check_namespace, "//", "two slashes in a row, at character 2"},
};

TEST(Names, GoodNamesPassAndBadOnesAreExplained) {
  for (const Row& row : rows) EXPECT_EQ(text_of(row.check(row.name)), row.text) << row.name;
}

// Every byte at every position of an otherwise good name.
TEST(Names, OnlyTheAlphabetPasses) {
  const std::string letters = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ_";
  const std::string digits = "0123456789";
  for (int value = 0; value < 256; ++value) {
    const char c = static_cast<char>(value);
    const bool is_letter = letters.find(c) != std::string::npos;
    const bool is_digit = digits.find(c) != std::string::npos;
    EXPECT_EQ(check_topic_name("/"s + c + "x").has_value(), !is_letter) << value;
    EXPECT_EQ(check_topic_name("/x"s + c + "x").has_value(), !(is_letter || is_digit || c == '/'))
        << value;
    EXPECT_EQ(check_topic_name("/x"s + c).has_value(), !(is_letter || is_digit)) << value;
  }
}

std::string expand(std::string_view name, std::string_view node = "talker",
                   std::string_view node_namespace = "/robot") {
  const auto full = expand_topic_name(name, node, node_namespace);
  return full ? *full : full.error().text();
}

TEST(Names, RelativeAndPrivateNamesAreExpanded) {
  EXPECT_EQ(expand("/chatter"), "/chatter");
  EXPECT_EQ(expand("chatter"), "/robot/chatter");
  EXPECT_EQ(expand("chatter", "talker", "/"), "/chatter");
  EXPECT_EQ(expand("arm/joints", "talker", "/robot/left"), "/robot/left/arm/joints");
  EXPECT_EQ(expand("~"), "/robot/talker");
  EXPECT_EQ(expand("~", "talker", "/"), "/talker");
  EXPECT_EQ(expand("~/status"), "/robot/talker/status");
  EXPECT_EQ(expand("~/a/b", "talker", "/"), "/talker/a/b");
}

TEST(Names, BadSpellingsAreRefusedWhereTheyAreWrong) {
  EXPECT_EQ(expand(""), "the name is empty, at character 1");
  EXPECT_EQ(expand("~x"), "a slash has to follow the tilde, at character 2");
  EXPECT_EQ(expand("~~"), "a slash has to follow the tilde, at character 2");
  EXPECT_EQ(expand("~/"), "a slash cannot be the last character, at character 2");
  EXPECT_EQ(expand("~//a"), "two slashes in a row, at character 3");
  EXPECT_EQ(expand("a~"), "a tilde can only be the first character, at character 2");
  EXPECT_EQ(expand("a/"), "a slash cannot be the last character, at character 2");
  EXPECT_EQ(expand("/"), "a slash cannot be the last character, at character 1");
  EXPECT_EQ(expand("2a"), "a digit cannot be the first character of a token, at character 1");
  EXPECT_EQ(expand("{ns}/a"), "substitutions in braces are not supported, at character 1");
}

TEST(Names, ExpansionThatIsTooLongIsRefused) {
  const std::string node_namespace = "/" + std::string(200, 'n');
  EXPECT_EQ(expand(std::string(53, 'x'), "talker", node_namespace).size(), name_length_max);
  EXPECT_EQ(expand(std::string(54, 'x'), "talker", node_namespace),
            "the fully qualified name is longer than 255 characters, at character 54");
  EXPECT_EQ(expand("~", std::string(54, 't'), node_namespace),
            "the fully qualified name is longer than 255 characters, at character 1");
}

// Every expansion passes the check for topic names.
TEST(Names, ExpansionsAreFullyQualifiedNames) {
  for (const char* name : {"/a", "a", "~", "~/a", "a/b", "~/a/b9", "_"}) {
    for (const char* node_namespace : {"/", "/r", "/r/s"})
      EXPECT_EQ(text_of(check_topic_name(expand(name, "n", node_namespace))), "good") << name;
  }
}

}  // namespace
}  // namespace agnocast
