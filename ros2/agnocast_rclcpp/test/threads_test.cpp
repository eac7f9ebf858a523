// SPDX-License-Identifier: Apache-2.0
//
// Goal: the threads of rclcpp's executors get what the [[thread]] rules of agnocastd say for the
// node and callback group that they run.
// Method: agnocastd with thread_rules.toml, nodes in rclcpp's executors; the callbacks ask the
// kernel.

#include "test_node.hpp"

#include <sched.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>

namespace agnocast_rclcpp {
namespace {

/// The kernel's struct sched_attr, sched_setattr(2).
struct Attributes {
  std::uint32_t size = sizeof(Attributes), policy = 0;
  std::uint64_t flags = 0;
  std::int32_t nice = 0;
  std::uint32_t priority = 0;
  std::uint64_t runtime = 0, deadline = 0, period = 0;
};
Attributes attributes() {
  Attributes of_thread;
  if (::syscall(SYS_sched_getattr, 0, &of_thread, sizeof of_thread, 0) != 0) of_thread.policy = ~0U;
  return of_thread;
}
/// Returns why the kernel refuses this to a thread of this process; 0: it does not.
int refusal_of(Attributes wanted) {
  int error = 0;
  std::thread([&] {
    if (::syscall(SYS_sched_setattr, 0, &wanted, 0) != 0) error = errno;
  }).join();
  return error;
}
int policy() { return ::sched_getscheduler(0) & ~SCHED_RESET_ON_FORK; }
int nice_value() { return ::getpriority(PRIO_PROCESS, static_cast<id_t>(::syscall(SYS_gettid))); }

class Threads : public RclcppTest {
 protected:
  void SetUp() override {
    RclcppTest::SetUp();
    node = std::make_shared<rclcpp::Node>("scheduled");
  }
  /// Publishes until a callback of this group has run in a thread for which this holds.
  bool are_scheduled(rclcpp::Executor& executor, const rclcpp::CallbackGroup::SharedPtr& group,
                     const std::function<bool()>& is_as_wanted) {
    rclcpp::SubscriptionOptions options;
    options.callback_group = group;
    std::atomic<bool> is_seen{false};
    auto subscription = agnocast::create_subscription<String>(
        node, "topic", 10,
        [&](const String&) {
          if (is_as_wanted()) is_seen = true;
        },
        options);
    auto publisher = agnocast::create_publisher<String>(node, "topic", 10);
    executor.add_node(node);
    const SpinningThread spinning(executor);
    return eventually([&] {
      auto message = publisher->borrow_loaned_message();
      message->data = "x";
      (void)publisher->publish(std::move(message));
      return is_seen.load();
    });
  }

  static std::function<bool()> has(int wanted_policy, int wanted_nice) {
    return [=] { return policy() == wanted_policy && nice_value() == wanted_nice; };
  }

  rclcpp::Node::SharedPtr node;
};

TEST_F(Threads, TheDefaultGroupHasItsRule) {
  EXPECT_TRUE(are_scheduled(*single_threaded.make(), nullptr, has(SCHED_BATCH, 3)));
}

TEST_F(Threads, AnotherGroupHasTheRuleOfTheNode) {
  auto group = node->create_callback_group(rclcpp::CallbackGroupType::Reentrant);
  EXPECT_TRUE(are_scheduled(*multi_threaded(4).make(), group, has(SCHED_OTHER, 8)));
}

TEST_F(Threads, APriorityAndProcessorsAreThoseOfTheRule) {
  Attributes wanted;
  wanted.policy = SCHED_FIFO;
  wanted.priority = 4;
  if (refusal_of(wanted) == EPERM) GTEST_SKIP() << "this user may not have real-time policies";
  node = std::make_shared<rclcpp::Node>("real_time");
  EXPECT_TRUE(are_scheduled(*multi_threaded(2).make(), nullptr, [] {
    const Attributes now = attributes();
    cpu_set_t processors;
    return now.policy == SCHED_FIFO && now.priority == 4 &&
           ::sched_getaffinity(0, sizeof processors, &processors) == 0 &&
           CPU_COUNT(&processors) == 1 && CPU_ISSET(0, &processors);
  }));
}

TEST_F(Threads, ADeadlineIsThatOfTheRule) {
  Attributes wanted;
  wanted.policy = SCHED_DEADLINE;
  wanted.runtime = 2'000'000;
  wanted.deadline = 20'000'000;
  wanted.period = 30'000'000;
  if (const int error = refusal_of(wanted); error != 0)
    GTEST_SKIP() << "SCHED_DEADLINE needs CAP_SYS_NICE, room and all processors: "
                 << std::strerror(error);
  node = std::make_shared<rclcpp::Node>("deadline");
  EXPECT_TRUE(are_scheduled(*single_threaded.make(), nullptr, [&] {
    const Attributes now = attributes();
    return now.policy == SCHED_DEADLINE && now.runtime == wanted.runtime &&
           now.deadline == wanted.deadline && now.period == wanted.period;
  }));
}

TEST_F(Threads, TheThreadThatWakesExecutorsHasAGroupOfItsOwn) {
  const auto subscription =
      agnocast::create_subscription<String>(node, "topic", 10, [](const String&) {});
  const auto nice_of_guard = [] {
    for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
      std::string name;
      std::getline(std::ifstream(task.path() / "comm"), name);
      if (name == "agnocast-guard") {
        const auto id = std::stoul(task.path().filename().string());
        return ::getpriority(PRIO_PROCESS, static_cast<id_t>(id));
      }
    }
    return -1;
  };
  EXPECT_TRUE(eventually([&] { return nice_of_guard() == 5; })) << nice_of_guard();
}

}  // namespace
}  // namespace agnocast_rclcpp
