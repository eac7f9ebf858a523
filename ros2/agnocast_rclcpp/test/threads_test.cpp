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
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <utility>

namespace agnocast_rclcpp {
namespace {

int policy() { return ::sched_getscheduler(0) & ~SCHED_RESET_ON_FORK; }
int nice_value() { return ::getpriority(PRIO_PROCESS, static_cast<id_t>(::syscall(SYS_gettid))); }

class Threads : public RclcppTest {
 protected:
  void SetUp() override {
    RclcppTest::SetUp();
    node = std::make_shared<rclcpp::Node>("scheduled");
  }
  /// Publishes until a callback of this group has run in a thread with this scheduling.
  bool are_scheduled(rclcpp::Executor& executor, const rclcpp::CallbackGroup::SharedPtr& group,
                     std::pair<int, int> wanted) {
    rclcpp::SubscriptionOptions options;
    options.callback_group = group;
    std::atomic<bool> is_seen{false};
    auto subscription = agnocast::create_subscription<String>(
        node, "topic", 10,
        [&](const String&) {
          if (std::pair(policy(), nice_value()) == wanted) is_seen = true;
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

  rclcpp::Node::SharedPtr node;
};

TEST_F(Threads, TheDefaultGroupHasItsRule) {
  EXPECT_TRUE(are_scheduled(*single_threaded.make(), nullptr, {SCHED_BATCH, 3}));
}

TEST_F(Threads, AnotherGroupHasTheRuleOfTheNode) {
  auto group = node->create_callback_group(rclcpp::CallbackGroupType::Reentrant);
  EXPECT_TRUE(are_scheduled(*multi_threaded(4).make(), group, {SCHED_OTHER, 8}));
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
