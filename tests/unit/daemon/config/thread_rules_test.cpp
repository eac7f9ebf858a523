// SPDX-License-Identifier: Apache-2.0
//
// Goal: each mistake in a thread rule is reported with its position and a remedy, a printed rule
// reads back unchanged, and the first rule that matches a callback group is found. Method: tables
// of mistakes with exact texts and of matches, every form of a rule, and random rules (seeded).
// User and group names are the test's own.

#include <daemon/config/rule_reading.hpp>
#include <daemon/config/scheduling_text.hpp>
#include <tests/unit/daemon/config/config_text.hpp>

#include <gmock/gmock.h>

#include <sched.h>

#include <bitset>
#include <iterator>
#include <random>
#include <sstream>
#include <string>
#include <vector>

namespace agnocast::daemon {
namespace {

using abi::wire::ThreadScheduling;
using testing::ElementsAre;

// Returns one complete rule with these lines; the first of them is line 4.
std::string rule_with(const std::string& lines) {
  return "[[thread]]\nnode = \"/a\"\nusers = [\"*\"]\n" + lines;
}

ThreadRule one_rule(const std::string& text) {
  auto config = parse(text);
  EXPECT_TRUE(config) << errors_of(text);
  if (!config) return {};
  EXPECT_EQ(config->threads.size(), 1U);
  return config->threads.at(0);
}

ThreadScheduling scheduling_of(const std::string& lines) {
  return one_rule(rule_with(lines)).scheduling;
}

std::vector<unsigned> cpus_of(const ThreadScheduling& scheduling) {
  std::vector<unsigned> cpus;
  for (unsigned cpu = 0; cpu < abi::cpu_count_max; ++cpu) {
    if ((scheduling.cpus[cpu / 64] >> cpu % 64 & 1) != 0) cpus.push_back(cpu);
  }
  return cpus;
}

struct Row {
  std::string text;
  std::string errors;
};

void expect_errors(std::initializer_list<Row> rows) {
  for (const Row& row : rows) EXPECT_EQ(errors_of(row.text), row.errors) << row.text;
}

TEST(ThreadRules, EveryKeyArrives) {
  const ThreadRule rule = one_rule(R"([quota]
[[thread]]
process = "lidar_*"
node = "/lidar/**"
group = "points"
users = ["user:alice", "uid:7", "group:sensors", "gid:8"]
policy = "fifo"
priority = 40
cpus = "0-3,6"
)");
  EXPECT_EQ(rule.process, "lidar_*");
  EXPECT_EQ(rule.node, "/lidar/**");
  EXPECT_EQ(rule.group, "points");
  EXPECT_THAT(rule.users.uids, ElementsAre(1000U, 7U));
  EXPECT_THAT(rule.users.gids, ElementsAre(50U, 8U));
  EXPECT_FALSE(rule.users.everybody);
  EXPECT_EQ(rule.line, 2U);
  EXPECT_EQ(rule.scheduling.sets_policy, 1U);
  EXPECT_EQ(rule.scheduling.policy, unsigned{SCHED_FIFO});
  EXPECT_EQ(rule.scheduling.priority, 40U);
  EXPECT_EQ(rule.scheduling.sets_nice, 0U);
  EXPECT_EQ(rule.scheduling.sets_cpus, 1U);
  EXPECT_THAT(cpus_of(rule.scheduling), ElementsAre(0U, 1U, 2U, 3U, 6U));
  EXPECT_EQ(rule.written_cpus, "0-3,6");
}

TEST(ThreadRules, EachPolicyHasItsOwnParameters) {
  const auto policy_of_rule = [](const std::string& lines) {
    const ThreadScheduling scheduling = scheduling_of(lines);
    EXPECT_EQ(scheduling.sets_policy, 1U);
    return static_cast<int>(scheduling.policy);
  };
  EXPECT_EQ(policy_of_rule("policy = \"other\"\n"), SCHED_OTHER);
  EXPECT_EQ(policy_of_rule("policy = \"other\"\nnice = -20\n"), SCHED_OTHER);
  EXPECT_EQ(policy_of_rule("policy = \"batch\"\nnice = 19\n"), SCHED_BATCH);
  EXPECT_EQ(policy_of_rule("policy = \"idle\"\ncpus = \"0\"\n"), SCHED_IDLE);
  EXPECT_EQ(policy_of_rule("policy = \"fifo\"\npriority = 1\n"), SCHED_FIFO);
  EXPECT_EQ(policy_of_rule("policy = \"rr\"\npriority = 99\n"), SCHED_RR);
  EXPECT_EQ(policy_of_rule("policy = \"deadline\"\nruntime = \"1ms\"\nperiod = \"9ms\"\n"),
            SCHED_DEADLINE);
}

TEST(ThreadRules, NiceOrProcessorsAreEnough) {
  const ThreadScheduling nice = scheduling_of("nice = -5\n");
  EXPECT_EQ(nice.sets_policy, 0U);
  EXPECT_EQ(nice.sets_nice, 1U);
  EXPECT_EQ(nice.nice, -5);
  EXPECT_EQ(nice.sets_cpus, 0U);
  EXPECT_EQ(scheduling_of("nice = 0\n").sets_nice, 1U);

  const ThreadScheduling cpus = scheduling_of("cpus = \"63-64,1023,0\"\n");
  EXPECT_EQ(cpus.sets_policy, 0U);
  EXPECT_EQ(cpus.sets_nice, 0U);
  EXPECT_EQ(cpus.sets_cpus, 1U);
  EXPECT_THAT(cpus_of(cpus), ElementsAre(0U, 63U, 64U, 1023U));
}

TEST(ThreadRules, DeadlineAndPeriodAreEachOthersDefault) {
  const std::string policy = "policy = \"deadline\"\nruntime = \"1500us\"\n";
  const auto times = [](const ThreadScheduling& scheduling) {
    return std::vector{scheduling.runtime_ns, scheduling.deadline_ns, scheduling.period_ns};
  };
  EXPECT_THAT(times(scheduling_of(policy + "deadline = \"5ms\"\n")),
              ElementsAre(1'500'000U, 5'000'000U, 5'000'000U));
  EXPECT_THAT(times(scheduling_of(policy + "period = \"1 s\"\n")),
              ElementsAre(1'500'000U, 1'000'000'000U, 1'000'000'000U));
  EXPECT_THAT(times(scheduling_of(policy + "deadline = \"1500000ns\"\nperiod = \"2ms\"\n")),
              ElementsAre(1'500'000U, 1'500'000U, 2'000'000U));
  EXPECT_EQ(scheduling_of("policy = \"deadline\"\nruntime = \"1024ns\"\nperiod = \"1024ns\"\n")
                .runtime_ns,
            1024U);
}

TEST(ThreadRules, MistakesInPatternsAreReported) {
  const std::string rest = "users = [\"*\"]\nnice = 1\n";
  const std::string process =
      "; write a pattern of the first 15 characters of the program's name: "
      "\"lidar_*\"";
  const std::string node = "; write a pattern of names of nodes: \"/lidar/**\"";
  const std::string group = "; write a pattern of names of callback groups: \"points*\"";
  expect_errors({
      {"[[thread]]\nnode = 5\n" + rest,
       "f.toml:2:8: thread.node: an integer is not allowed here" + node},
      {"[[thread]]\nnode = \"lidar\"\n" + rest,
       "f.toml:2:8: thread.node: \"lidar\": a pattern starts with a slash or with **, at "
       "character 1" +
           node},
      {"[[thread]]\nnode = \"\"\n" + rest,
       "f.toml:2:8: thread.node: \"\": the pattern is empty, at character 1" + node},
      {"[[thread]]\ngroup = true\n" + rest,
       "f.toml:2:9: thread.group: true or false is not allowed here" + group},
      {"[[thread]]\ngroup = \"\"\n" + rest,
       "f.toml:2:9: thread.group: \"\": the pattern is empty" + group},
      {"[[thread]]\ngroup = \"a***b\"\n" + rest,
       "f.toml:2:9: thread.group: \"a***b\": more than two stars in a row" + group},
      {"[[thread]]\ngroup = \"a\\nb\"\n" + rest,
       "f.toml:2:9: thread.group: \"a\\nb\": only characters of ASCII that can be printed are "
       "allowed" +
           group},
      {"[[thread]]\ngroup = \"" + std::string(256, '?') + "\"\n" + rest,
       "f.toml:2:9: thread.group: \"" + std::string(256, '?') +
           "\": the pattern is longer than 255 characters" + group},
      {"[[thread]]\nprocess = [\"a\"]\n" + rest,
       "f.toml:2:11: thread.process: a list is not allowed here" + process},
      {"[[thread]]\nprocess = \"\"\n" + rest,
       "f.toml:2:11: thread.process: \"\": the pattern is empty" + process},
      {"[[thread]]\nprocess = \"/usr/bin/a\"\n" + rest,
       "f.toml:2:11: thread.process: \"/usr/bin/a\": the name of a program has no slash" + process},
      {"[[thread]]\nprocess = \"robot_state_publisher\"\n" + rest,
       "f.toml:2:11: thread.process: \"robot_state_publisher\": the kernel keeps 15 characters of "
       "a program's name" +
           process},
  });
  EXPECT_EQ(one_rule("[[thread]]\nprocess = \"*robot_state_pub*\"\n" + rest).process,
            "*robot_state_pub*");
  EXPECT_EQ(one_rule("[[thread]]\ngroup = \"a b/c: \\\"\\\\\"\n" + rest).group, "a b/c: \"\\");
}

TEST(ThreadRules, IncompleteRulesAreReported) {
  const std::string policies = "other, fifo, rr, batch, idle, deadline";
  expect_errors({
      {"[thread]\nnode = \"/a\"\n",
       "f.toml:1:1: thread: a table is not allowed here; write each rule as a table: [[thread]]"},
      {"thread = [1]\n",
       "f.toml:1:11: thread: an integer is not allowed here; write each rule as a table: "
       "[[thread]]"},
      {rule_with("nice = 1\ncolour = 4\n"),
       "f.toml:5:1: thread.colour: unknown key; known here: process, node, group, users, policy, "
       "priority, nice, runtime, deadline, period, cpus"},
      {rule_with("nice = 1\npolcy = 4\n"),
       "f.toml:5:1: thread.polcy: unknown key; did you mean \"policy\"?"},
      {"[[thread]]\nusers = [\"*\"]\nnice = 1\n",
       "f.toml:1:1: thread: the rule names no callback groups; add process, node or group; node = "
       "\"**\" stands for every node"},
      {"[[thread]]\nnode = \"**\"\nnice = 1\n",
       "f.toml:1:1: thread.users: is missing; name the users whose processes it is for: "
       "[\"user:NAME\"]"},
      {"[[thread]]\nnode = \"**\"\nusers = []\nnice = 1\n",
       "f.toml:3:9: thread.users: the rule has no effect; name the users whose processes it is "
       "for"},
      {"[[thread]]\nnode = \"**\"\nusers = \"*\"\nnice = 1\n",
       "f.toml:3:9: thread.users: a string is not allowed here; write a list: [\"user:NAME\", "
       "\"group:NAME\", \"uid:1000\", \"gid:1000\" or \"*\"]"},
      {"[[thread]]\nnode = \"**\"\nusers = [\"user:bob\"]\nnice = 1\n",
       "f.toml:3:10: thread.users: there is no user \"bob\"; correct the name, or use uid:NUMBER"},
      {rule_with(""), "f.toml:1:1: thread: the rule has no effect; add policy, nice or cpus"},
      {"[[thread]]\n",
       "f.toml:1:1: thread.users: is missing; name the users whose processes it is for: "
       "[\"user:NAME\"]\n"
       "f.toml:1:1: thread: the rule names no callback groups; add process, node or group; node = "
       "\"**\" stands for every node\n"
       "f.toml:1:1: thread: the rule has no effect; add policy, nice or cpus"},
      {rule_with("policy = 1\npriority = 1\n"),
       "f.toml:4:10: thread.policy: an integer is not allowed here; write one of " + policies},
      {rule_with("policy = \"FIFO\"\npriority = 1\n"),
       "f.toml:4:10: thread.policy: \"FIFO\" is not a policy; use " + policies},
  });
}

TEST(ThreadRules, MistakesInPriorityAndNiceAreReported) {
  expect_errors({
      {rule_with("policy = \"fifo\"\n"),
       "f.toml:4:10: thread.priority: is missing; add one: priority = 1 to 99, the highest"},
      {rule_with("policy = \"rr\"\n"),
       "f.toml:4:10: thread.priority: is missing; add one: priority = 1 to 99, the highest"},
      {rule_with("policy = \"rr\"\npriority = 0\n"),
       "f.toml:5:12: thread.priority: 0 is out of range; use 1 to 99"},
      {rule_with("policy = \"rr\"\npriority = 100\n"),
       "f.toml:5:12: thread.priority: 100 is out of range; use 1 to 99"},
      {rule_with("policy = \"rr\"\npriority = \"high\"\n"),
       "f.toml:5:12: thread.priority: a string is not allowed here; write an integer"},
      {rule_with("nice = 1\npriority = 5\n"),
       "f.toml:5:12: thread.priority: is for the policies fifo and rr; remove it, or add such a "
       "policy"},
      {rule_with("policy = \"other\"\npriority = 5\n"),
       "f.toml:5:12: thread.priority: is for the policies fifo and rr; remove it, or add such a "
       "policy"},
      {rule_with("nice = -21\n"), "f.toml:4:8: thread.nice: -21 is out of range; use -20 to 19"},
      {rule_with("nice = 20\n"), "f.toml:4:8: thread.nice: 20 is out of range; use -20 to 19"},
      {rule_with("nice = 1.5\n"),
       "f.toml:4:8: thread.nice: a number with a fraction is not allowed here; write an integer"},
      {rule_with("policy = \"fifo\"\npriority = 5\nnice = 1\n"),
       "f.toml:6:8: thread.nice: is for the policies other and batch; remove it, or use such a "
       "policy"},
      {rule_with("policy = \"idle\"\nnice = 1\n"),
       "f.toml:5:8: thread.nice: is for the policies other and batch; remove it, or use such a "
       "policy"},
  });
}

TEST(ThreadRules, MistakesInTimesAreReported) {
  const std::string policy = "policy = \"deadline\"\n";
  const std::string form = "; write a whole number and its unit: \"5ms\" (ns, us, ms, s)";
  expect_errors({
      {rule_with(policy),
       "f.toml:4:10: thread.runtime: is missing; add the time that the thread needs in each "
       "period: runtime = \"2ms\"\n"
       "f.toml:4:10: thread.period: is missing; add period, deadline or both: period = \"10ms\""},
      {rule_with(policy + "period = \"1s\"\n"),
       "f.toml:4:10: thread.runtime: is missing; add the time that the thread needs in each "
       "period: runtime = \"2ms\""},
      {rule_with(policy + "runtime = 5\nperiod = \"1s\"\n"),
       "f.toml:5:11: thread.runtime: an integer is not allowed here" + form},
      {rule_with(policy + "runtime = \"1.5ms\"\nperiod = \"1s\"\n"),
       "f.toml:5:11: thread.runtime: \"1.5ms\" is not a duration below 2^63 ns" + form},
      {rule_with(policy + "runtime = \"5ms\"\nperiod = \"1min\"\n"),
       "f.toml:6:10: thread.period: \"1min\" is not a duration below 2^63 ns" + form},
      {rule_with(policy + "runtime = \"5ms\"\nperiod = \"9223372037s\"\n"),
       "f.toml:6:10: thread.period: \"9223372037s\" is not a duration below 2^63 ns" + form},
      {rule_with(policy + "runtime = \"1023ns\"\nperiod = \"1s\"\n"),
       "f.toml:5:11: thread.runtime: 1023ns is too short; use 1024ns or more"},
      {rule_with(policy + "runtime = \"5ms\"\ndeadline = \"0ms\"\n"),
       "f.toml:5:11: thread.runtime: 5ms is more than the deadline (0ms); the order is runtime <= "
       "deadline <= period"},
      {rule_with(policy + "runtime = \"5ms\"\nperiod = \"4999us\"\n"),
       "f.toml:5:11: thread.runtime: 5ms is more than the period (4999us); the order is runtime "
       "<= deadline <= period"},
      {rule_with(policy + "runtime = \"5ms\"\ndeadline = \"2s\"\nperiod = \"1s\"\n"),
       "f.toml:6:12: thread.deadline: 2s is more than the period (1s); the order is runtime <= "
       "deadline <= period"},
      {rule_with(policy + "runtime = \"5ms\"\nperiod = \"1s\"\nnice = 1\n"),
       "f.toml:7:8: thread.nice: is for the policies other and batch; remove it, or use such a "
       "policy"},
      {rule_with("policy = \"fifo\"\npriority = 1\nruntime = \"5ms\"\n"),
       "f.toml:6:11: thread.runtime: is for the policy deadline; remove it, or use that policy"},
      {rule_with("nice = 1\ndeadline = \"5ms\"\nperiod = \"5ms\"\n"),
       "f.toml:5:12: thread.deadline: is for the policy deadline; remove it, or use that policy\n"
       "f.toml:6:10: thread.period: is for the policy deadline; remove it, or use that policy"},
  });
}

TEST(ThreadRules, MistakesInProcessorsAreReported) {
  const auto error = [](const std::string& list, const std::string& what) {
    return Row{rule_with("cpus = \"" + list + "\"\n"),
               "f.toml:4:8: thread.cpus: \"" + list + "\": " + what +
                   "; write processors from 0 to 1023 like \"0-3,6\""};
  };
  const auto malformed = [&](const std::string& list, const std::string& part) {
    return error(list, '"' + part + "\" is neither a processor nor a range of them");
  };
  expect_errors({
      malformed("", ""),
      malformed("0,", ""),
      malformed(",0", ""),
      malformed("all", "all"),
      malformed("1-", "1-"),
      malformed("-1", "-1"),
      malformed("1--2", "1--2"),
      malformed("0-3, 6", " 6"),
      malformed("0-7:1/2", "0-7:1/2"),
      malformed("99999999999999999999", "99999999999999999999"),
      error("3-1", "\"3-1\" begins with the higher number"),
      error("0,1024", "processor 1024 is out of range"),
      error("1000-1024", "processor 1024 is out of range"),
      {rule_with("cpus = 3\n"),
       "f.toml:4:8: thread.cpus: an integer is not allowed here; write a list of processors as a "
       "string: \"0-3,6\""},
      {rule_with("policy = \"deadline\"\nruntime = \"1ms\"\nperiod = \"9ms\"\ncpus = \"0\"\n"),
       "f.toml:7:8: thread.cpus: cannot be set with the policy deadline: the kernel wants such a "
       "thread to be allowed on all processors of its root domain (sched(7)); remove it, and "
       "divide the processors with cpusets (cpuset(7))"},
  });
}

TEST(ThreadRules, RulesThatNeverDecideAreReported) {
  const auto rule = [](const std::string& patterns) {
    return "[[thread]]\n" + patterns + "\nusers = [\"*\"]\nnice = 1\n";
  };
  const std::string never =
      "f.toml:5:1: thread: never decides: line 1 has the same threads and comes first; join both "
      "rules, or put the narrower one first";
  const std::string a = "node = \"/a\"", b = "node = \"/b\"", everything = "node = \"**\"";
  const std::string a_points = "node = \"/a\"\ngroup = \"points\"";
  const std::string points = "group = \"points\"";
  expect_errors({
      {rule(a) + rule(a), never},
      {rule(a) + rule(a_points), never},
      {rule(everything) + rule(b), never},
      {rule(everything) + rule(points), never},
      {rule(points) + rule("group = \"points\"\nprocess = \"x\""), never},
      // A rule with a mistake is none.
      {"[[thread]]\nnode = \"/a\"\nnice = 1\n" + rule(a),
       "f.toml:1:1: thread.users: is missing; name the users whose processes it is for: "
       "[\"user:NAME\"]"},
  });
  const std::string all = rule(a_points) + rule(a) + rule(b) + rule(points) + rule(everything);
  ASSERT_EQ(errors_of(all), "no error");
  EXPECT_EQ(parse(all)->threads.size(), 5U);
}

TEST(ThreadRules, NumberIsLimited) {
  std::string text;
  for (std::size_t i = 0; i < thread_rule_count_max; ++i)
    text += "[[thread]]\nnode = \"/n" + std::to_string(i) + "\"\nusers = [\"*\"]\nnice = 1\n";
  ASSERT_TRUE(parse(text)) << errors_of(text);
  EXPECT_EQ(parse(text)->threads.size(), thread_rule_count_max);
  EXPECT_EQ(errors_of(text + rule_with("nice = 1\n")),
            "f.toml:1025:1: thread: there are more than 256 rules; join some of them with "
            "patterns");
}

ThreadRule rule_of(const char* process, const char* node, const char* group) {
  const auto pattern = [](const char* text) {
    return text != nullptr ? std::optional<std::string>(text) : std::nullopt;
  };
  ThreadRule rule;
  rule.process = pattern(process);
  rule.node = pattern(node);
  rule.group = pattern(group);
  return rule;
}

TEST(ThreadRules, FirstRuleThatMatchesDecides) {
  const std::vector<ThreadRule> rules = {
      rule_of("lidar_driver", "/lidar/front", "points"),
      rule_of("lidar_*", nullptr, "points"),
      rule_of(nullptr, "/lidar/*", nullptr),
      rule_of(nullptr, nullptr, "a/*"),
      rule_of("?", nullptr, nullptr),
      rule_of(nullptr, "/late/**", "?*"),
      rule_of(nullptr, nullptr, "b**"),
  };
  const struct {
    GroupNames names;
    std::optional<std::size_t> rule;
  } rows[] = {
      {{"lidar_driver", "/lidar/front", "points"}, 0},
      {{"lidar_driver", "/lidar/rear", "points"}, 1},
      {{"lidar_", "", "points"}, 1},
      {{"lidar", "/lidar/front", "points"}, 2},
      {{"lidar_driver", "/lidar/front", "status"}, 2},
      {{"lidar_driver", "/lidar/front", ""}, 2},
      {{"lidar_driver", "/lidar/front/left", "points2"}, std::nullopt},
      {{"", "", "a/b"}, 3},
      {{"", "", "a/b/c"}, std::nullopt},
      {{"x", "/n", ""}, 4},
      {{"xy", "/n", ""}, std::nullopt},
      {{"xy", "/late/n/m", "g"}, 5},
      {{"xy", "/late/n/m", ""}, std::nullopt},
      {{"xy", "/n", "b/c/d"}, 6},
      {{"LIDAR_driver", "/n", "points"}, std::nullopt},
      {{"", "", ""}, std::nullopt},
  };
  for (const auto& row : rows) {
    EXPECT_EQ(matching_rule(rules, row.names), row.rule)
        << row.names.process << ' ' << row.names.node << ' ' << row.names.group;
  }
  EXPECT_EQ(matching_rule({}, {"a", "/b", "c"}), std::nullopt);
  const std::vector<ThreadRule> everything = {rule_of(nullptr, "**", nullptr)};
  EXPECT_EQ(matching_rule(everything, {"a", "/b/c", "d"}), 0U);
  EXPECT_EQ(matching_rule(everything, {"", "", ""}), 0U);
}

TEST(ThreadRules, EverythingButTheLineIsCompared) {
  const ThreadRule rule = one_rule(rule_with("nice = 1\ncpus = \"1\"\n"));
  ThreadRule other = rule;
  other.line = 99;
  EXPECT_TRUE(rule == other);
  const auto differs = [&](auto&& change) {
    ThreadRule changed = rule;
    change(changed);
    return !(changed == rule);
  };
  EXPECT_TRUE(differs([](ThreadRule& one) { one.process = "x"; }));
  EXPECT_TRUE(differs([](ThreadRule& one) { one.node.reset(); }));
  EXPECT_TRUE(differs([](ThreadRule& one) { one.group = "x"; }));
  EXPECT_TRUE(differs([](ThreadRule& one) { one.users.uids.push_back(1); }));
  EXPECT_TRUE(differs([](ThreadRule& one) { one.scheduling.nice = 2; }));
  EXPECT_TRUE(differs([](ThreadRule& one) { one.scheduling.cpus[15] = 1; }));
  EXPECT_TRUE(differs([](ThreadRule& one) { one.written_cpus = "1,1"; }));
}

// A scheduling that a rule may set.
void choose_scheduling(std::mt19937_64& random, ThreadRule& rule) {
  const auto below = [&](std::uint64_t bound) { return random() % bound; };
  ThreadScheduling& scheduling = rule.scheduling;
  constexpr std::uint32_t policies[] = {SCHED_OTHER, SCHED_FIFO, SCHED_RR,
                                        SCHED_BATCH, SCHED_IDLE, SCHED_DEADLINE};
  const std::uint64_t choice = below(std::size(policies) + 1);
  if (choice < std::size(policies)) {
    scheduling.sets_policy = 1;
    scheduling.policy = policies[choice];
  }
  const bool is_fixed = scheduling.policy == SCHED_FIFO || scheduling.policy == SCHED_RR;
  if (is_fixed) scheduling.priority = static_cast<std::uint32_t>(1 + below(99));
  if (scheduling.policy == SCHED_DEADLINE) {
    constexpr std::uint64_t units[] = {1, 1'000, 1'000'000, 1'000'000'000};
    scheduling.runtime_ns = (1024 + below(1000)) * units[below(std::size(units))];
    scheduling.deadline_ns = scheduling.runtime_ns + below(1000) * units[below(std::size(units))];
    scheduling.period_ns = scheduling.deadline_ns + below(1000) * units[below(std::size(units))];
    return;
  }
  if ((scheduling.policy == SCHED_OTHER || scheduling.policy == SCHED_BATCH) && below(2) != 0) {
    scheduling.sets_nice = 1;
    scheduling.nice = static_cast<std::int64_t>(below(40)) - 20;
  }
  const bool has_effect = scheduling.sets_policy != 0 || scheduling.sets_nice != 0;
  if (has_effect && below(2) != 0) return;
  scheduling.sets_cpus = 1;
  rule.written_cpus = "0-2,1023";
  scheduling.cpus[0] = 7;
  scheduling.cpus[15] = std::uint64_t{1} << 63;
}

TEST(ThreadRules, PrintedRulesReadBackTheSame) {
  std::mt19937_64 random(20261127);
  const auto below = [&](std::uint64_t bound) { return random() % bound; };
  for (int round = 0; round < 300; ++round) {
    Config config;
    if (below(2)) config.quota.callback_groups = unlimited;
    config.quota.callback_threads = below(1 << 20);
    for (std::uint64_t i = below(4); i > 0; --i) {
      ThreadRule rule;
      const std::string number = std::to_string(i);
      rule.node = "/node" + number + "/**";
      if (below(2)) rule.process = "a: \"\\" + number + '*';
      if (below(2)) rule.group = "points \\ \"" + number + '?';
      rule.users = Principals{false, {1000, 7}, {50}, {"user:alice", "uid:7", "group:sensors"}};
      if (below(2)) rule.users = Principals{true, {}, {}, {"*"}};
      choose_scheduling(random, rule);
      config.threads.push_back(rule);
    }
    const std::string text = to_toml(config);
    const auto again = parse(text);
    ASSERT_TRUE(again) << again.error().front().text() << '\n' << text;
    ASSERT_EQ(*again, config) << text;
  }
}

// The explanation ends with rules in comments.
TEST(ThreadRules, ExamplesInThePrintedConfigurationAreRules) {
  std::istringstream lines(to_toml(Config{}));
  std::string text, line;
  while (std::getline(lines, line)) {
    if (line == "# [[thread]]" || !text.empty())
      text += line.substr(std::min<std::size_t>(2, line.size())) + '\n';
  }
  const auto config = parse(text);
  ASSERT_TRUE(config) << errors_of(text) << '\n' << text;
  EXPECT_EQ(config->threads.size(), 3U);
}

TEST(ThreadRules, DurationsAreExact) {
  EXPECT_EQ(parse_duration("0ns"), 0U);
  EXPECT_EQ(parse_duration("800us"), 800'000U);
  EXPECT_EQ(parse_duration("5 ms"), 5'000'000U);
  EXPECT_EQ(parse_duration("9223372036s"), 9'223'372'036'000'000'000U);
  EXPECT_EQ(parse_duration("9223372036854775807ns"), 9'223'372'036'854'775'807U);
  for (const char* text : {"", "5", "ms", "5MS", "5m", "-5ms", "+5ms", " 5ms", "5ms ", "5  ms",
                           "0x5ms", "5e3ms", "9223372036854775808ns", "99999999999999999999ns"})
    EXPECT_EQ(parse_duration(text), std::nullopt) << text;
  EXPECT_EQ(duration_text(0), "0ns");
  EXPECT_EQ(duration_text(1'500'000), "1500us");
  EXPECT_EQ(duration_text(5'000'000), "5ms");
  EXPECT_EQ(duration_text(60'000'000'000), "60s");
  EXPECT_EQ(duration_text(1'000'001), "1000001ns");
}

TEST(ThreadRules, PoliciesHaveNames) {
  for (const int policy :
       {SCHED_OTHER, SCHED_FIFO, SCHED_RR, SCHED_BATCH, SCHED_IDLE, SCHED_DEADLINE}) {
    const std::string_view name = policy_name(static_cast<std::uint32_t>(policy));
    EXPECT_NE(policy_names.find(name), std::string_view::npos);
    EXPECT_EQ(policy_of(name), static_cast<std::uint32_t>(policy));
  }
  EXPECT_EQ(policy_name(4), "");
  EXPECT_EQ(policy_of("normal"), std::nullopt);
}

}  // namespace
}  // namespace agnocast::daemon
