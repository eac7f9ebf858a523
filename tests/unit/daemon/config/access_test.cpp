// SPDX-License-Identifier: Apache-2.0
//
// Goal: exactly the users that the rules name may use a topic, and the deciding rule is known.
// Method: tables of patterns and decisions; a plain recursive matcher as a second opinion.

#include <agnocast/topic_pattern.hpp>
#include <base/text/names.hpp>
#include <daemon/config/access.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <ctime>
#include <string>
#include <vector>

namespace agnocast::daemon {
namespace {

TEST(TopicPattern, Matches) {
  const struct {
    const char* pattern;
    const char* topic;
    bool matches;
  } rows[] = {
      {"/a", "/a", true},
      {"/a", "/b", false},
      {"/a", "/a/b", false},
      {"/a", "/ab", false},
      {"/*", "/a", true},
      {"/*", "/a/b", false},
      {"/*/b", "/a/b", true},
      {"/*/b", "/a/c/b", false},
      {"/lidar/*", "/lidar/points", true},
      {"/lidar/*", "/lidar", false},
      {"/lidar*", "/lidar_front", true},
      {"/lidar*", "/lidar", true},
      {"/lidar*", "/lidar/x", false},
      {"/lidar/**", "/lidar/front/points", true},
      {"/lidar/**", "/lidar", false},
      {"/lidar**", "/lidar", true},
      {"/lidar**", "/lidar/front", true},
      {"**", "/anything/at/all", true},
      {"**/status", "/a/b/status", true},
      {"**/status", "/status", true},
      {"**/status", "/a/status2", false},
      {"/?", "/a", true},
      {"/?", "/ab", false},
      {"/a?b", "/a/b", false},
      {"/a**b", "/a/x/b", true},
      {"/*a*b*", "/xxaxxbxx", true},
      {"/*a*b*", "/xxbxxaxx", false},
      {"/A", "/a", false},
  };
  for (const auto& row : rows)
    EXPECT_EQ(topic_matches(row.pattern, row.topic), row.matches)
        << row.pattern << ' ' << row.topic;
}

bool matches_plainly(std::string_view pattern, std::string_view topic) {
  if (pattern.empty()) return topic.empty();
  if (pattern.starts_with("**")) {
    for (std::size_t skip = 0; skip <= topic.size(); ++skip) {
      if (matches_plainly(pattern.substr(2), topic.substr(skip))) return true;
    }
    return false;
  }
  if (pattern[0] == '*') {
    for (std::size_t skip = 0; skip <= topic.size(); ++skip) {
      if (matches_plainly(pattern.substr(1), topic.substr(skip))) return true;
      if (skip < topic.size() && topic[skip] == '/') return false;
    }
    return false;
  }
  if (topic.empty()) return false;
  const bool same = pattern[0] == topic[0] || (pattern[0] == '?' && topic[0] != '/');
  return same && matches_plainly(pattern.substr(1), topic.substr(1));
}

// All patterns and all topics of up to five characters over a small alphabet.
TEST(TopicPattern, AgreesWithASecondMatcher) {
  const auto all = [](std::string_view alphabet, std::size_t length_max) {
    std::vector<std::string> words{""};
    for (std::size_t begin = 0, length = 0; length < length_max; ++length) {
      const std::size_t end = words.size();
      for (; begin < end; ++begin) {
        for (const char c : alphabet) words.push_back(words[begin] + c);
      }
    }
    return words;
  };
  const auto topics = all("a/", 5);
  std::size_t match_count = 0;
  for (const std::string& pattern : all("a/*?", 5)) {
    if (topic_pattern_problem(pattern)) continue;
    for (const std::string& topic : topics) {
      const bool matches = topic_matches(pattern, topic);
      match_count += matches ? 1 : 0;
      ASSERT_EQ(matches, matches_plainly(pattern, topic)) << pattern << ' ' << topic;
    }
  }
  EXPECT_GT(match_count, 500U);
}

TEST(TopicPattern, HostilePatternsAreMatchedQuickly) {
  std::string pattern = "/";
  while (pattern.size() + 2 <= name_length_max) pattern += "*a";
  const std::string topic = "/" + std::string(name_length_max - 2, 'a') + "b";
  const std::clock_t begin = std::clock();  // processor time, whatever else runs
  for (int i = 0; i < 100; ++i) EXPECT_FALSE(topic_matches(pattern, topic));
  EXPECT_LT((std::clock() - begin) / CLOCKS_PER_SEC, 10);
  EXPECT_FALSE(topic_matches("/" + std::string(name_length_max, '*'), "/a"))
      << "longer than allowed";
}

TEST(TopicPattern, BadOnesAreRefusedWithTheReason) {
  const struct {
    const char* pattern;
    const char* text;
  } rows[] = {
      {"/a/*", "good"},
      {"**", "good"},
      {"**/x", "good"},
      {"/a?_9/**", "good"},
      {"", "the pattern is empty, at character 1"},
      {"lidar", "a pattern starts with a slash or with **, at character 1"},
      {"*", "a pattern starts with a slash or with **, at character 1"},
      {"/a//b", "two slashes in a row, at character 4"},
      {"/a/", "a slash cannot be the last character, at character 3"},
      {"/***", "more than two stars in a row, at character 4"},
      {"/[ab]", "only letters, digits, underscores, slashes, * and ? are allowed, at character 2"},
  };
  for (const auto& row : rows) {
    const auto problem = topic_pattern_problem(row.pattern);
    EXPECT_EQ(problem.value_or("good"), row.text) << row.pattern;
  }
  EXPECT_EQ(*topic_pattern_problem("/" + std::string(255, 'a')),
            "the pattern is longer than 255 characters, at character 256");
}

Principals uids(std::vector<uid_t> list) { return {false, std::move(list), {}, {}}; }
Principals gids(std::vector<gid_t> list) { return {false, {}, std::move(list), {}}; }
Principals everybody() { return {true, {}, {}, {}}; }

struct Access : testing::Test {
  // line numbers are 10, 20, …
  std::vector<AccessRule> rules = {
      {"/lidar/**", 7, uids({1000}), std::nullopt, 10},
      {"/lidar/**", std::nullopt, gids({50, 51}), everybody(), 20},
      {"/secret/*", std::nullopt, uids({}), uids({1001}), 30},
  };
  std::string decided(Subject subject, std::uint64_t domain, std::string_view topic,
                      Action action) {
    const Decision decision = decide(rules, subject, domain, topic, action);
    std::string text = decision.allowed ? "allowed" : "denied";
    text += decision.rule ? " by rule " + std::to_string(*decision.rule) : " by default";
    return text + (decision.line != 0 ? " line " + std::to_string(decision.line) : "");
  }
};

TEST_F(Access, NoRuleMeansAllowed) {
  EXPECT_EQ(decided({1, {}}, 0, "/chatter", Action::publish), "allowed by default");
  rules.clear();
  EXPECT_EQ(decided({1, {}}, 0, "/lidar/x", Action::publish), "allowed by default");
}

TEST_F(Access, FirstRuleOfTheDomainForTheActionDecides) {
  EXPECT_EQ(decided({1000, {}}, 7, "/lidar/x", Action::publish), "allowed by rule 0 line 10");
  EXPECT_EQ(decided({1002, {50}}, 7, "/lidar/x", Action::publish), "denied by rule 0 line 10");
  EXPECT_EQ(decided({1002, {50}}, 0, "/lidar/x", Action::publish), "allowed by rule 1 line 20");
  EXPECT_EQ(decided({1000, {}}, 0, "/lidar/x", Action::publish), "denied by rule 1 line 20");
  EXPECT_EQ(decided({1002, {}}, 7, "/lidar/x", Action::subscribe), "allowed by rule 1 line 20");
}

TEST_F(Access, GroupsArePrimaryOrSupplementary) {
  EXPECT_EQ(decided({9, {1, 2, 51}}, 0, "/lidar/x", Action::publish), "allowed by rule 1 line 20");
  EXPECT_EQ(decided({9, {1, 2, 52}}, 0, "/lidar/x", Action::publish), "denied by rule 1 line 20");
  EXPECT_EQ(decided({50, {}}, 0, "/lidar/x", Action::publish), "denied by rule 1 line 20")
      << "a uid is no gid";
}

TEST_F(Access, EmptyListAdmitsNobodyNotEvenRoot) {
  EXPECT_EQ(decided({0, {0}}, 0, "/secret/x", Action::publish), "denied by rule 2 line 30");
  EXPECT_EQ(decided({0, {0}}, 0, "/secret/x", Action::subscribe), "denied by rule 2 line 30");
  EXPECT_EQ(decided({1001, {}}, 0, "/secret/x", Action::subscribe), "allowed by rule 2 line 30");
}

Principals only(std::vector<uid_t> uids, std::vector<gid_t> gids = {}) {
  return {false, std::move(uids), std::move(gids), {}};
}

TEST(Readers, AreEqualExactlyWhereTheSameUsersAndGroupsMaySubscribe) {
  const Principals everybody{true, {7}, {}, {"*"}};
  const std::vector<AccessRule> rules{
      {"/a", {}, {}, only({1, 2}), 1},      {"/b", {}, {}, only({2, 1, 2}), 2},
      {"/c", {}, {}, only({1}), 3},         {"/d", {}, {}, only({1, 2}, {1}), 4},
      {"/e", {}, {}, only({}), 5},          {"/f", {}, {}, everybody, 6},
      {"/g", {}, only({1}), {}, 7},         {"/h", 3, {}, only({1, 2}), 8},
      {"/i", {}, {}, only({1}, {2}), 9},    {"/j", {}, {}, only({2}, {1}), 10},
      {"/k", {}, {}, only({}, {1, 2}), 11},
  };
  const auto readers = [&](const char* topic, std::uint64_t domain = 0) {
    return readers_of(rules, domain, topic);
  };
  EXPECT_EQ(readers("/a"), readers("/b"));
  EXPECT_EQ(readers("/f"), everybody_reads);
  EXPECT_EQ(readers("/g"), everybody_reads) << "no rule is about subscribing";
  EXPECT_EQ(readers("/none"), everybody_reads);
  EXPECT_EQ(readers("/h"), everybody_reads) << "another domain";
  EXPECT_EQ(readers("/h", 3), readers("/a"));
  std::vector<std::uint64_t> all;
  for (const char* topic : {"/a", "/c", "/d", "/e", "/f", "/i", "/j", "/k"}) {
    EXPECT_EQ(std::count(all.begin(), all.end(), readers(topic)), 0) << topic;
    EXPECT_NE(readers(topic), 0u);
    all.push_back(readers(topic));
  }
}

}  // namespace
}  // namespace agnocast::daemon
