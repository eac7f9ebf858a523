// SPDX-License-Identifier: Apache-2.0
//
// Goal: callbacks of an exclusive group never run at the same time, those of different groups and
// of a reentrant group do, in the executors with several threads; a group runs in one executor.
// Method: executor_fixture.hpp.

#include <tests/integration/client/executors/executor_fixture.hpp>
#include <tests/integration/client/executors/spinning_thread.hpp>

#include <gmock/gmock.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <future>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

class CallbackGroups : public ExecutorFixture {};

/// Two groups of one node, each with a subscription to a topic of its own.
struct TwoGroups {
  explicit TwoGroups(const std::string& name, CallbackGroupType type) : node(name) {
    for (auto& group : groups) group = node.create_callback_group(type);
  }
  Subscription<Number>::SharedPtr subscribe(std::size_t group, const std::string& topic,
                                            std::function<void(const Message&)> callback) {
    return node.create_subscription<Number>(topic, 1000, std::move(callback),
                                            SubscriptionOptions().callback_group(groups[group]));
  }
  Node node;
  CallbackGroup::SharedPtr groups[2];
};

TEST_F(CallbackGroups, AGroupThatIsInNoExecutorRunsNothing) {
  TwoGroups two(own("node"), CallbackGroupType::MutuallyExclusive);
  std::atomic<int> got{0};
  auto subscription = two.subscribe(0, own("topic"), [&](const Message&) { ++got; });
  auto publisher = two.node.create_publisher<Number>(own("topic"), 1000);
  ASSERT_TRUE(eventually([&] { return subscription->get_linked_publisher_count() == 1; }));
  publish(*publisher, 1);
  std::this_thread::sleep_for(50ms);
  EXPECT_EQ(got, 0);
  SingleThreadedExecutor executor;
  executor.add_callback_group(two.groups[0]);
  executor.spin_some();
  EXPECT_EQ(got, 1);
  executor.remove_callback_group(two.groups[0]);
  publish(*publisher, 2);
  executor.spin_some();
  EXPECT_EQ(got, 1);
}

TEST_F(CallbackGroups, AGroupStaysWhereItWasAddedAlone) {
  Node node(own("node"));
  auto apart = node.create_callback_group(CallbackGroupType::MutuallyExclusive, false);
  auto with = node.create_callback_group(CallbackGroupType::MutuallyExclusive);
  EXPECT_FALSE(apart->automatically_add_to_executor_with_node());
  EXPECT_EQ(apart->type(), CallbackGroupType::MutuallyExclusive);
  SingleThreadedExecutor executor, other;
  other.add_callback_group(with);
  executor.add_node(node);
  EXPECT_THAT(error_of([&] { executor.add_callback_group(with); }), testing::HasSubstr("already"));
  EXPECT_THAT(error_of([&] { executor.remove_callback_group(with); }),
              testing::HasSubstr("not in this executor"));
  executor.add_callback_group(apart);
  executor.remove_node(node);
  EXPECT_THAT(error_of([&] { other.add_callback_group(apart); }), testing::HasSubstr("already"));
  executor.remove_callback_group(apart);
  other.add_callback_group(apart);
  Node another(own("another"));
  EXPECT_THAT(error_of([&] {
                auto refused = another.create_subscription<Number>(
                    own("topic"), 1, [](const Message&) {},
                    SubscriptionOptions().callback_group(with));
              }),
              testing::HasSubstr("the callback group belongs to another node"));
}

// More groups than wait sets: they share, and each is woken all the same.
TEST_F(CallbackGroups, NodesBeyondTheWaitSetsOfAProcessShareThem) {
  constexpr std::size_t count = 200;
  std::vector<std::unique_ptr<Node>> nodes;
  std::vector<Subscription<Number>::SharedPtr> subscriptions;
  std::vector<std::atomic<int>> got(count);
  SingleThreadedExecutor executor, other;
  for (std::size_t i = 0; i < count; ++i) {
    nodes.push_back(std::make_unique<Node>(own("node") + std::to_string(i)));
    (i % 2 == 0 ? executor : other).add_node(*nodes.back());
    subscriptions.push_back(nodes.back()->create_subscription<Number>(
        own("topic"), 1, [&got, i](const Message&) { ++got[i]; }));
  }
  std::thread one([&] { executor.spin(); }), two([&] { other.spin(); });
  auto publisher = nodes.front()->create_publisher<Number>(own("topic"), 1);
  EXPECT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == count; }));
  for (int value = 1; value <= 5; ++value) {
    publish(*publisher, static_cast<std::uint64_t>(value));
    EXPECT_TRUE(eventually([&] {
      return std::all_of(got.begin(), got.end(), [&](const auto& of) { return of == value; });
    })) << value;
  }
  executor.cancel();
  other.cancel();
  one.join();
  two.join();
}

// The last subscription of the node goes, and the next one comes, while the callback still runs.
TEST_F(CallbackGroups, ACallbackThatReplacesItsSubscriptionNeverRunsConcurrently) {
  Node node(own("node"));
  std::atomic<int> inside{0}, overlaps{0}, first{0}, second{0};
  const auto enter = [&] {
    if (inside.fetch_add(1) != 0) ++overlaps;
  };
  auto publisher = node.create_publisher<Number>(own("topic"), QoS(1).transient_local());
  publish(*publisher, 1);
  Subscription<Number>::SharedPtr subscription;
  subscription =
      node.create_subscription<Number>(own("topic"), QoS(1).transient_local(), [&](const Message&) {
        enter();
        subscription.reset();
        subscription = node.create_subscription<Number>(own("topic"), QoS(1).transient_local(),
                                                        [&](const Message&) {
                                                          enter();
                                                          ++second;
                                                          --inside;
                                                        });
        // Time for a concurrent callback, if there were one.
        for (int i = 0; i < 300 && overlaps == 0; ++i) std::this_thread::sleep_for(1ms);
        --inside;
        ++first;
      });
  MultiThreadedExecutor executor(3);
  executor.add_node(node);
  const SpinningThread spinning(executor);
  EXPECT_TRUE(eventually([&] { return first == 1 && second == 1; })) << first << second;
  EXPECT_EQ(overlaps, 0);
}

TEST_F(CallbackGroups, SeveralThreadsRunDifferentGroupsAtOnceAndOneGroupNever) {
  TwoGroups two(own("node"), CallbackGroupType::MutuallyExclusive);
  std::atomic<int> inside[2]{}, overlaps{0}, together{0};
  std::uint64_t unguarded[2]{};
  std::vector<Subscription<Number>::SharedPtr> subscriptions;
  for (std::size_t i = 0; i < 4; ++i) {
    const std::size_t group = i / 2;
    subscriptions.push_back(two.subscribe(group, own("topic"), [&, group](const Message& number) {
      if (inside[group].fetch_add(1) != 0) ++overlaps;
      // The callbacks of the first message stay until one of the other group has come.
      if (number->value == 1 && eventually([&] { return inside[1 - group] != 0 || together != 0; }))
        ++together;
      ++unguarded[group];
      std::this_thread::sleep_for(100us);
      --inside[group];
    }));
  }
  auto publisher = two.node.create_publisher<Number>(own("topic"), 1000);
  MultiThreadedExecutor executor(4);
  EXPECT_EQ(executor.get_number_of_threads(), 4u);
  executor.add_node(two.node);
  {
    const SpinningThread spinning(executor);
    ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 4; }));
    for (std::uint64_t value = 1; value <= 200; ++value) {
      publish(*publisher, value);
      std::this_thread::sleep_for(std::chrono::microseconds(value * 7 % 300));
    }
  }
  executor.spin_all(0s);  // what was published just before the end
  EXPECT_EQ(overlaps, 0);
  EXPECT_EQ(together, 4);
  EXPECT_EQ(unguarded[0], 400u);
  EXPECT_EQ(unguarded[1], 400u);
}

TEST_F(CallbackGroups, AReentrantGroupRunsOneSubscriptionInSeveralThreads) {
  TwoGroups two(own("node"), CallbackGroupType::Reentrant);
  std::atomic<int> inside{0}, met{0};
  auto subscription = two.subscribe(0, own("topic"), [&](const Message&) {
    ++inside;
    if (eventually([&] { return inside >= 2; })) ++met;
  });
  auto publisher = two.node.create_publisher<Number>(own("topic"), 1000);
  ASSERT_TRUE(eventually([&] { return subscription->get_linked_publisher_count() == 1; }));
  MultiThreadedExecutor executor(2);
  executor.add_node(two.node);
  const SpinningThread spinning(executor);
  publish(*publisher, 1);
  publish(*publisher, 2);
  EXPECT_TRUE(eventually([&] { return met == 2; }));
}

TEST_F(CallbackGroups, ACallbackIsolatedExecutorGivesEachGroupItsThread) {
  TwoGroups two(own("node"), CallbackGroupType::MutuallyExclusive);
  Seen seen[3];
  std::promise<void> may_end;
  auto blocked = may_end.get_future().share();
  auto first = two.subscribe(0, own("first"), [&](const Message& number) {
    blocked.wait();
    seen[0].add(number->value);
  });
  auto second =
      two.subscribe(1, own("second"), [&](const Message& number) { seen[1].add(number->value); });
  auto to_first = two.node.create_publisher<Number>(own("first"), 10);
  auto to_second = two.node.create_publisher<Number>(own("second"), 10);
  ASSERT_TRUE(eventually([&] {
    return first->get_linked_publisher_count() == 1 && second->get_linked_publisher_count() == 1;
  }));
  CallbackIsolatedExecutor executor;
  executor.add_node(two.node);
  {
    const SpinningThread spinning(executor);
    publish(*to_first, 1);
    publish(*to_second, 1);
    EXPECT_TRUE(eventually([&] { return seen[1].count() == 1; })) << "the first is blocked";
    // A group that comes while it spins, and goes.
    auto third_group = two.node.create_callback_group(CallbackGroupType::MutuallyExclusive);
    auto third = two.node.create_subscription<Number>(
        own("second"), 10, [&](const Message& number) { seen[2].add(number->value); },
        SubscriptionOptions().callback_group(third_group));
    ASSERT_TRUE(eventually([&] { return third->get_linked_publisher_count() == 1; }));
    publish(*to_second, 2);
    EXPECT_TRUE(eventually([&] { return seen[1].count() == 2 && seen[2].count() == 1; }));
    third.reset();
    third_group.reset();
    publish(*to_second, 3);
    EXPECT_TRUE(eventually([&] { return seen[1].count() == 3; }));
    EXPECT_EQ(seen[0].count(), 0u);
    may_end.set_value();
    EXPECT_TRUE(eventually([&] { return seen[0].count() == 1; }));
  }
  EXPECT_NE(seen[0].threads[0], seen[1].threads[0]);
  EXPECT_NE(seen[1].threads[0], seen[2].threads[0]);
  EXPECT_THAT(seen[1].threads, testing::Each(seen[1].threads[0]));
  publish(*to_second, 4);
  executor.spin_some();
  EXPECT_EQ(seen[1].threads[3], std::this_thread::get_id()) << "other spin functions go on";
}

template <class Made>
void leaves_spin(const std::string& name, const std::string& topic) {
  Node node(name);
  std::atomic<int> got{0};
  auto subscription = node.create_subscription<Number>(topic, 10, [&](const Message&) {
    if (++got == 1) throw std::runtime_error("the first");
  });
  auto publisher = node.create_publisher<Number>(topic, 10);
  Made executor;
  executor.add_node(node);
  ASSERT_TRUE(eventually([&] { return subscription->get_linked_publisher_count() == 1; }));
  auto number = publisher->borrow_loaned_message();
  ASSERT_TRUE(publisher->publish(std::move(number)));
  EXPECT_THROW(executor.spin(), std::runtime_error);
  EXPECT_FALSE(executor.is_spinning());
  number = publisher->borrow_loaned_message();
  ASSERT_TRUE(publisher->publish(std::move(number)));
  const SpinningThread spinning(executor);
  EXPECT_TRUE(eventually([&] { return got == 2; }));
}

TEST_F(CallbackGroups, AnExceptionLeavesTheSpinOfSeveralThreads) {
  leaves_spin<MultiThreadedExecutor>(own("node"), own("topic"));
  leaves_spin<CallbackIsolatedExecutor>(own("isolated"), own("other"));
}

}  // namespace
}  // namespace agnocast
