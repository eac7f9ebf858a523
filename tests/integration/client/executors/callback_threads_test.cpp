// SPDX-License-Identifier: Apache-2.0
//
// Goal: the daemon knows the callback groups of a process and the threads that run them, under
// every executor; the rules of its configuration are in force for these threads, as the kernel
// says; a daemon that comes back knows and applies the same.
// Method: a real daemon with rules, executors in this process, and `agnocast-ctl thread list`,
// which reads back from the kernel. Real-time policies are tested where the kernel allows them.

#include <tests/integration/client/executors/executor_fixture.hpp>
#include <tests/integration/client/executors/spinning_thread.hpp>
#include <tests/support/processes/ctl.hpp>

#include <gmock/gmock.h>

#include <sched.h>
#include <sys/resource.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <vector>

namespace agnocast {
namespace {

using nlohmann::json;

// All but /real_time need no privilege: a daemon may lower the priority of its user's processes.
constexpr const char* rules = R"(
[[thread]]
node = "/camera"
group = "grabber"
users = ["*"]
policy = "batch"
nice = 4

[[thread]]
node = "/camera"
users = ["*"]
nice = 7

[[thread]]
node = "/lidar/**"
users = ["*"]
nice = 9

[[thread]]
node = "/stranger"
users = ["uid:4294967294"]
nice = 11

[[thread]]
node = "/real_time"
group = "fifo"
users = ["*"]
policy = "fifo"
priority = 12

[[thread]]
node = "/real_time"
group = "round_robin"
users = ["*"]
policy = "rr"
priority = 3
cpus = "0"

[[thread]]
node = "/real_time"
group = "deadline"
users = ["*"]
policy = "deadline"
runtime = "1ms"
deadline = "8ms"
period = "20ms"

[[thread]]
node = "/nowhere"
users = ["*"]
cpus = "1023"
)";

int nice_of(pid_t thread) { return ::getpriority(PRIO_PROCESS, static_cast<id_t>(thread)); }

class Threads : public ExecutorFixture {
 protected:
  static void SetUpTestSuite() { start({.more_config = rules}); }

  /// The threads of this process, as agnocast-ctl lists them.
  static json listed() {
    json mine = json::array();
    const json all = test::run_ctl(daemon->socket_path(), {"thread", "list", "-j"}).json();
    for (const json& thread : all["threads"]) {
      if (thread["pid"] == ::getpid()) mine.push_back(thread);
    }
    return mine;
  }
  /// The listed threads that run a group of this node.
  static json listed_of(const std::string& space, const std::string& node) {
    json found = json::array();
    for (const json& thread : listed()) {
      for (const json& group : thread["groups"]) {
        if (group["node_name"] != node || group["node_namespace"] != space) continue;
        found.push_back(thread);
        break;
      }
    }
    return found;
  }
};

TEST_F(Threads, TheRuleOfANodeIsInForceForTheThreadOfItsExecutor) {
  Node node("camera");
  auto subscription = node.create_subscription<Number>(own("topic"), 1, [](const Message&) {});
  SingleThreadedExecutor executor;
  executor.add_node(node);
  const SpinningThread spinning(executor);
  ASSERT_TRUE(
      eventually([&] { return spinning.number() != 0 && nice_of(spinning.number()) == 7; }));
  json listed;
  ASSERT_TRUE(eventually([&] {
    listed = listed_of("/", "camera");
    return listed.size() == 1 && listed[0]["rule"]["state"] == "applied";
  }));
  EXPECT_EQ(listed[0]["tid"], spinning.number());
  EXPECT_EQ(listed[0]["kernel"]["nice"], 7);
  EXPECT_EQ(listed[0]["kernel"]["policy"], "other");
  EXPECT_EQ(listed[0]["groups"][0]["name"], "default");
  EXPECT_EQ(listed[0]["groups"][0]["reentrant"], false);
}

TEST_F(Threads, EachGroupOfAnIsolatedExecutorHasItsOwnThreadAndRule) {
  Node node("camera");
  auto grabber = create_callback_group(node, CallbackGroupType::Reentrant, true, "grabber");
  auto in_grabber = node.create_subscription<Number>(
      own("grabbed"), 1, [](const Message&) {}, SubscriptionOptions().callback_group(grabber));
  auto other = node.create_subscription<Number>(own("other"), 1, [](const Message&) {});
  CallbackIsolatedExecutor executor;
  executor.add_node(node);
  const SpinningThread spinning(executor);
  json listed;
  ASSERT_TRUE(eventually([&] {
    listed = listed_of("/", "camera");
    return listed.size() == 2 && listed[0]["rule"]["state"] == "applied" &&
           listed[1]["rule"]["state"] == "applied";
  })) << listed;
  for (const json& thread : listed) {
    ASSERT_EQ(thread["groups"].size(), 1u);
    const bool is_grabber = thread["groups"][0]["name"] == "grabber";
    EXPECT_EQ(thread["groups"][0]["reentrant"], is_grabber);
    const pid_t number = thread["tid"];
    EXPECT_EQ(::sched_getscheduler(number), is_grabber ? SCHED_BATCH : SCHED_OTHER);
    EXPECT_EQ(nice_of(number), is_grabber ? 4 : 7);
  }
}

// Everything that a rule sets is what the kernel has.
TEST_F(Threads, PolicyPriorityDeadlineAndProcessorsEqualTheFile) {
  Node node("real_time");
  std::vector<Subscription<Number>::SharedPtr> subscriptions;
  for (const char* const name : {"fifo", "round_robin", "deadline"}) {
    auto group = create_callback_group(node, CallbackGroupType::MutuallyExclusive, true, name);
    subscriptions.push_back(node.create_subscription<Number>(
        own(name), 1, [](const Message&) {}, SubscriptionOptions().callback_group(group)));
  }
  CallbackIsolatedExecutor executor;
  executor.add_node(node);
  const SpinningThread spinning(executor);
  json listed;
  ASSERT_TRUE(eventually([&] {
    listed = listed_of("/", "real_time");
    std::size_t decided = 0;
    for (const json& thread : listed) decided += thread["rule"]["state"] != "due";
    return decided == 3;
  })) << listed;
  std::size_t compared = 0;
  for (const json& thread : listed) {
    const json &rule = thread["rule"], &kernel = thread["kernel"];
    // EPERM: no CAP_SYS_NICE, or no time for the cgroup; EBUSY: no room for a deadline.
    if (rule["state"] == "refused" && (rule["errno"] == EPERM || rule["errno"] == EBUSY)) continue;
    ASSERT_EQ(rule["state"], "applied") << thread;
    for (const auto& [key, wanted] : rule["scheduling"].items()) {
      if (wanted.is_null()) continue;
      EXPECT_EQ(kernel[key], wanted) << key << " of " << thread;
    }
    EXPECT_EQ(kernel["reset_on_fork"], true);
    ++compared;
  }
  if (compared < listed.size())
    GTEST_SKIP() << "the kernel allows " << compared << " of three real-time rules here";
}

TEST_F(Threads, AllThreadsOfAMultiThreadedExecutorAreListedAndGoWithIt) {
  Node node("front", "/lidar");
  auto group = create_callback_group(node, CallbackGroupType::Reentrant);
  auto subscription = node.create_subscription<Number>(
      own("topic"), 1, [](const Message&) {}, SubscriptionOptions().callback_group(group));
  MultiThreadedExecutor executor(4);
  executor.add_node(node);
  {
    const SpinningThread spinning(executor);
    json listed;
    ASSERT_TRUE(eventually([&] {
      listed = listed_of("/lidar", "front");
      std::size_t applied = 0;
      for (const json& thread : listed) applied += thread["rule"]["state"] == "applied";
      return applied == 4;
    })) << listed;
    std::set<pid_t> numbers;
    for (const json& thread : listed) {
      numbers.insert(thread["tid"].get<pid_t>());
      EXPECT_EQ(nice_of(thread["tid"]), 9);
    }
    EXPECT_EQ(numbers.size(), 4u);
  }
  EXPECT_TRUE(eventually([&] { return listed_of("/lidar", "front").empty(); }));
}

TEST_F(Threads, AGroupThatComesLaterBringsItsRule) {
  Node plain("plain"), node("camera");
  auto of_plain = plain.create_subscription<Number>(own("plain"), 1, [](const Message&) {});
  SingleThreadedExecutor executor;
  executor.add_node(plain);
  const SpinningThread spinning(executor);
  ASSERT_TRUE(eventually([&] { return listed_of("/", "plain").size() == 1; }));
  EXPECT_TRUE(listed_of("/", "plain")[0]["rule"].is_null());
  EXPECT_EQ(nice_of(spinning.number()), 0);
  auto of_camera = node.create_subscription<Number>(own("camera"), 1, [](const Message&) {});
  executor.add_node(node);
  EXPECT_TRUE(eventually([&] { return nice_of(spinning.number()) == 7; }));
}

TEST_F(Threads, ARuleForOtherUsersIsNotApplied) {
  Node node("stranger");
  BackgroundExecutor executor;
  executor.add_node(node);
  auto subscription = node.create_subscription<Number>(own("topic"), 1, [](const Message&) {});
  json listed;
  ASSERT_TRUE(eventually([&] {
    listed = listed_of("/", "stranger");
    return listed.size() == 1 && listed[0]["rule"]["state"] == "not_allowed";
  })) << listed;
  EXPECT_EQ(nice_of(listed[0]["tid"]), 0);
}

TEST_F(Threads, WhatTheKernelRefusesIsSaid) {
  Node node("nowhere");
  BackgroundExecutor executor;
  executor.add_node(node);
  auto subscription = node.create_subscription<Number>(own("topic"), 1, [](const Message&) {});
  json listed;
  ASSERT_TRUE(eventually([&] {
    listed = listed_of("/", "nowhere");
    return listed.size() == 1 && listed[0]["rule"]["state"] == "refused";
  })) << listed;
  EXPECT_EQ(listed[0]["rule"]["call"], "sched_setaffinity");
  const auto doctor = test::run_ctl(daemon->socket_path(), {"doctor", "-j"}).json();
  bool is_found = false;
  for (const json& check : doctor["checks"]) {
    if (check["id"] == "thread-settings") is_found = !check["findings"].empty();
  }
  EXPECT_TRUE(is_found) << doctor;
}

TEST_F(Threads, AThreadThatSpinsTwoExecutorsInTurnIsListedForBoth) {
  Node one("one"), two("two");
  auto of_one = one.create_subscription<Number>(own("one"), 1, [](const Message&) {});
  auto of_two = two.create_subscription<Number>(own("two"), 1, [](const Message&) {});
  SingleThreadedExecutor first, second;
  first.add_node(one);
  second.add_node(two);
  std::atomic<bool> is_over{false};
  std::thread spinner([&] {
    while (!is_over) {
      first.spin_once(1ms);
      second.spin_once(1ms);
    }
  });
  EXPECT_TRUE(eventually([&] {
    const json a = listed_of("/", "one"), b = listed_of("/", "two");
    return a.size() == 1 && b.size() == 1 && a[0]["tid"] == b[0]["tid"] &&
           a[0]["executors"].size() == 2;
  }));
  is_over = true;
  spinner.join();
  EXPECT_TRUE(eventually([&] { return listed_of("/", "one").empty(); }));
}

TEST_F(Threads, AnExecutorThatIsDestroyedTakesItsThreadsAlong) {
  Node node("camera");
  auto subscription = node.create_subscription<Number>(own("topic"), 1, [](const Message&) {});
  std::thread([&] {
    {
      SingleThreadedExecutor executor;
      executor.add_node(node);
      executor.spin_some();
      ASSERT_TRUE(eventually([&] { return listed_of("/", "camera").size() == 1; }));
    }
    EXPECT_TRUE(eventually([&] { return listed_of("/", "camera").empty(); }));
  }).join();
}

TEST_F(Threads, ADaemonThatComesBackKnowsAndAppliesTheSame) {
  Node node("camera");
  auto subscription = node.create_subscription<Number>(own("topic"), 1, [](const Message&) {});
  SingleThreadedExecutor executor;
  executor.add_node(node);
  const SpinningThread spinning(executor);
  ASSERT_TRUE(
      eventually([&] { return spinning.number() != 0 && nice_of(spinning.number()) == 7; }));
  const pid_t old = daemon->kill_worker();
  ASSERT_TRUE(daemon->wait_for_next(old));
  EXPECT_TRUE(eventually([&] {
    const json listed = listed_of("/", "camera");
    return listed.size() == 1 && listed[0]["rule"]["state"] == "applied";
  }));
  // A thread that begins under the new daemon has the rule as well.
  Node second("front", "/lidar");
  BackgroundExecutor background;
  background.add_node(second);
  auto of_second = second.create_subscription<Number>(own("second"), 1, [](const Message&) {});
  EXPECT_TRUE(eventually([&] {
    const json listed = listed_of("/lidar", "front");
    return listed.size() == 1 && nice_of(listed[0]["tid"]) == 9;
  }));
}

}  // namespace
}  // namespace agnocast
