// SPDX-License-Identifier: Apache-2.0
//
// When callbacks of agnocast run in an rclcpp node: never before somebody spins, never after
// rclcpp::shutdown, and whatever ends first.

#include "test_node.hpp"

#include <algorithm>
#include <stdexcept>
#include <vector>

namespace agnocast_rclcpp {
namespace {

using namespace std::chrono_literals;
using Message = agnocast::ipc_shared_ptr<const String>;

class CallbacksTest : public RclcppTest, public testing::WithParamInterface<const ExecutorKind*> {
 protected:
  std::unique_ptr<rclcpp::Executor> executor_;
  void SetUp() override {
    RclcppTest::SetUp();
    executor_ = GetParam()->make();
  }
  void TearDown() override {
    executor_.reset();
    RclcppTest::TearDown();
  }
};
INSTANTIATE_TEST_SUITE_P(Executors, CallbacksTest,
                         testing::Values(&single_threaded, &static_single_threaded,
                                         &multi_threaded(4)),
                         [](const auto& info) { return std::string(info.param->name); });

/// Publishes when something listens.
class Source {
 public:
  explicit Source(const std::string& topic = "topic")
      : node_(std::make_shared<rclcpp::Node>("source_of_" + topic)),
        publisher_(agnocast::create_publisher<String>(node_, topic, rclcpp::QoS(1000))) {}
  void publish(int count = 1) {
    ASSERT_TRUE(eventually([&] { return publisher_->get_subscription_count() != 0; }));
    for (int i = 0; i < count; ++i)
      ASSERT_EQ(publisher_->publish(String()).code, agnocast::Errc::ok);
  }

 private:
  rclcpp::Node::SharedPtr node_;
  agnocast::Publisher<String>::SharedPtr publisher_;
};

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

TEST_P(CallbacksTest, NothingRunsAfterShutdown) {
  Source source;
  std::atomic<int> heard{0};
  const auto node = std::make_shared<rclcpp::Node>("node");
  const auto subscription =
      agnocast::create_subscription<String>(node, "topic", 1000, [&](const Message&) { ++heard; });
  executor_->add_node(node);
  std::thread spinning([&] { executor_->spin(); });
  source.publish(10);
  EXPECT_TRUE(eventually([&] { return heard == 10; }));
  rclcpp::shutdown();
  spinning.join();
  source.publish(10);
  std::this_thread::sleep_for(50ms);
  EXPECT_EQ(heard, 10);
}

TEST_P(CallbacksTest, AnExceptionLeavesTheSpin) {
  Source source;
  const auto node = std::make_shared<rclcpp::Node>("node");
  std::atomic<int> heard{0};
  const auto subscription =
      agnocast::create_subscription<String>(node, "topic", 1000, [&](const Message&) {
        if (++heard == 1) throw std::runtime_error("from a callback");
      });
  executor_->add_node(node);
  source.publish(2);
  if (GetParam() == &multi_threaded(4)) {
    // Humble's other threads end with std::terminate(), so only the spinning one is asked.
    EXPECT_THROW(while (heard < 2) executor_->spin_once(), std::runtime_error);
  } else {
    EXPECT_THROW(executor_->spin(), std::runtime_error);
  }
  EXPECT_EQ(heard, 1);
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

TEST_F(RclcppTest, DestructionInEveryOrder) {
  enum What { node, subscription, group, executor, what_count };
  std::vector<int> order{node, subscription, group, executor};
  do {
    Source source;
    auto owner = std::make_shared<rclcpp::Node>("owner");
    auto callback_group =
        owner->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
    rclcpp::SubscriptionOptions options;
    options.callback_group = callback_group;
    std::atomic<int> heard{0};
    auto made = agnocast::create_subscription<String>(
        owner, "topic", 10, [&](const Message&) { ++heard; }, options);
    auto spinner = std::make_unique<rclcpp::executors::SingleThreadedExecutor>();
    spinner->add_node(owner);
    source.publish(2);
    while (heard == 0) spinner->spin_once(10ms);
    for (const int what : order) {
      if (what == node) owner.reset();
      if (what == subscription) made.reset();
      if (what == group) {
        callback_group.reset();
        options.callback_group.reset();
      }
      if (what == executor) {
        spinner.reset();
      } else if (spinner != nullptr) {
        spinner->spin_some(1ms);
      }
    }
  } while (std::next_permutation(order.begin(), order.end()));
}

}  // namespace
}  // namespace agnocast_rclcpp
