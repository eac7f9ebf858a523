// SPDX-License-Identifier: Apache-2.0
//
// When callbacks of agnocast run in an rclcpp node: never before somebody spins, then each of them,
// whatever comes and goes meanwhile. Their end: endings_test.cpp.

#include "test_node.hpp"

#include <vector>

namespace agnocast_rclcpp {
namespace {

using namespace std::chrono_literals;
using Message = agnocast::ipc_shared_ptr<const String>;

class CallbacksTest : public EveryExecutorTest {};
AGNOCAST_TEST_EXECUTORS(CallbacksTest);

/// A node as people write them: the handle is a member, and callbacks use shared_from_this().
class Listener : public rclcpp::Node {
 public:
  explicit Listener(Source& source) : Node("listener") {
    subscription_ = agnocast::create_subscription<String>(
        this, "topic", rclcpp::QoS(1000), [this](const Message&) {
          (void)shared_from_this();  // throws during the constructor
          ++heard;
        });
    source.publish(100);
    std::this_thread::sleep_for(50ms);
    heard_in_constructor = heard;
  }
  std::atomic<int> heard{0};
  int heard_in_constructor = -1;

 private:
  agnocast::Subscription<String>::SharedPtr subscription_;
};

TEST_P(CallbacksTest, NothingRunsBeforeTheSpin) {
  Source source;
  const auto listener = std::make_shared<Listener>(source);
  EXPECT_EQ(listener->heard_in_constructor, 0);
  executor_->add_node(listener);
  std::this_thread::sleep_for(50ms);
  EXPECT_EQ(listener->heard, 0);
  const SpinningThread spinning(*executor_);
  EXPECT_TRUE(eventually([&] { return listener->heard == 100; }));
}

TEST_P(CallbacksTest, MessagesWaitWhileAnExclusiveGroupIsBusy) {
  Source source;
  const auto node = std::make_shared<rclcpp::Node>("node");
  std::atomic<int> heard{0};
  const auto subscription =
      agnocast::create_subscription<String>(node, "topic", 1000, [&](const Message&) {
        ++heard;
        std::this_thread::sleep_for(1ms);
      });
  executor_->add_node(node);
  const SpinningThread spinning(*executor_);
  for (int i = 0; i < 50; ++i) source.publish(4);
  EXPECT_TRUE(eventually([&] { return heard == 200; }));
}

TEST_P(CallbacksTest, EndpointsMayEndWhileTheyAreServed) {
  Source source;
  const auto node = std::make_shared<rclcpp::Node>("node");
  executor_->add_node(node);
  // They outlive the spin: rclcpp's executor waits for a condition of each group, which ends with
  // it.
  std::vector<rclcpp::CallbackGroup::SharedPtr> groups;
  const SpinningThread spinning(*executor_);
  for (int round = 0; round < 100; ++round) {
    rclcpp::SubscriptionOptions options;
    // Humble's static executor finds no group that is created while it spins.
    if (round % 2 != 0 && GetParam() != &static_single_threaded) {
      groups.push_back(node->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive));
      options.callback_group = groups.back();
    }
    std::atomic<int> heard{0};
    const auto subscription = agnocast::create_subscription<String>(
        node, "topic", 1000, [&](const Message&) { ++heard; }, options);
    // The publisher may still count the subscription of the round before.
    source.publish(5);
    if (round % 3 == 0) continue;
    ASSERT_TRUE(eventually([&] {
      source.publish();
      return heard > 0;
    })) << "round "
        << round;
  }
}

TEST_P(CallbacksTest, ACallbackMayEndItsOwnSubscription) {
  Source source;
  const auto node = std::make_shared<rclcpp::Node>("node");
  std::atomic<int> heard{0};
  agnocast::Subscription<String>::SharedPtr subscription;
  subscription = agnocast::create_subscription<String>(node, "topic", 1000, [&](const Message&) {
    subscription.reset();
    ++heard;
  });
  source.publish(3);
  executor_->add_node(node);
  const SpinningThread spinning(*executor_);
  EXPECT_TRUE(eventually([&] { return heard == 1; }));
  std::this_thread::sleep_for(20ms);
  EXPECT_EQ(heard, 1);
}

TEST_P(CallbacksTest, NodesAreAddedAndRemovedWhileMessagesFlow) {
  if (GetParam() == &static_single_threaded)
    GTEST_SKIP() << "Humble's serves a node that was removed and added no more, rclcpp's own "
                    "subscriptions neither";
  Source source;
  const auto node = std::make_shared<rclcpp::Node>("node");
  std::atomic<int> heard{0}, theirs_heard{0};
  const auto subscription =
      agnocast::create_subscription<String>(node, "topic", 1000, [&](const Message&) { ++heard; });
  const auto theirs =
      node->create_subscription<String>("theirs", 1000, [&](const String&) { ++theirs_heard; });
  const auto to_theirs = node->create_publisher<String>("theirs", 1000);
  for (int round = 1; round <= 20; ++round) {
    executor_->add_node(node);
    source.publish(5);
    to_theirs->publish(String());
    {
      const SpinningThread spinning(*executor_);
      source.publish(5);
      EXPECT_TRUE(eventually([&] { return theirs_heard == round; })) << "rclcpp's, round " << round;
      ASSERT_TRUE(eventually([&] { return heard == 10 * round; })) << round;
    }
    executor_->remove_node(node);
  }
}

}  // namespace
}  // namespace agnocast_rclcpp
