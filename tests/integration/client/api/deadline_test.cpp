// SPDX-License-Identifier: Apache-2.0
//
// Goal: a publisher and a subscription with a deadline are notified of each period in which nothing
// was published, by getters and by callbacks of the executor, and of no other. Method: publishers
// and subscriptions in this process, with the real daemon. How many periods are over is computed
// from clocks read before and after.

#include <agnocast/agnocast.hpp>
#include <tests/integration/client/programs/second_process.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <thread>
#include <utility>

namespace agnocast {
namespace {

using namespace std::chrono_literals;
using std::chrono::nanoseconds;
using Clock = std::chrono::steady_clock;
using test::Number;

class Deadline : public test::SuiteDaemon {
 protected:
  static constexpr nanoseconds period = 20ms;

  void meet(const QoS& qos, const PublisherOptions& of_publisher = {},
            const SubscriptionOptions& of_subscription = {}) {
    publisher = node.create_publisher<Number>(own("topic"), qos, of_publisher);
    subscription = node.create_subscription<Number>(own("topic"), qos, of_subscription);
    ASSERT_TRUE(test::eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
    ASSERT_TRUE(test::eventually([&] { return subscription->get_linked_publisher_count() == 1; }));
  }
  void publish() {
    published_after = Clock::now();
    ASSERT_TRUE(publisher->publish(publisher->borrow_loaned_message()));
    published_before = Clock::now();
  }
  static void wait_for(int periods) { std::this_thread::sleep_for(periods * period); }
  /// Returns whether as many were missed as periods are over since the last message, when `ask` is
  /// asked.
  template <class Ask>
  testing::AssertionResult has_missed_all(Ask ask) const {
    const auto at_least = (Clock::now() - published_before) / period;
    const std::int32_t missed = ask().total_count;
    const auto at_most = (Clock::now() - published_after) / period;
    if (at_least <= missed && missed <= at_most) return testing::AssertionSuccess();
    return testing::AssertionFailure() << missed << " of " << at_least << " to " << at_most;
  }

  Node node{own("node")};
  Publisher<Number>::SharedPtr publisher;
  PollingSubscriber<Number>::SharedPtr subscription;
  Clock::time_point published_after, published_before;
};

TEST_F(Deadline, BeginsWithTheFirstMessage) {
  meet(QoS(10).deadline(period));
  wait_for(3);
  EXPECT_EQ(publisher->get_deadline_missed_status().total_count, 0);
  EXPECT_EQ(subscription->get_deadline_missed_status().total_count, 0);
}

TEST_F(Deadline, BothSidesCountEachPeriodOnce) {
  meet(QoS(10).deadline(period));
  publish();
  for (int i = 0; i < 5; ++i) {
    wait_for(1 + i % 2);
    EXPECT_TRUE(has_missed_all([&] { return publisher->get_deadline_missed_status(); }));
    EXPECT_TRUE(has_missed_all([&] { return subscription->get_deadline_missed_status(); }));
  }
  EXPECT_GE(subscription->get_deadline_missed_status().total_count, 5);
  EXPECT_GE(publisher->get_deadline_missed_status().total_count, 5);
}

TEST_F(Deadline, AChangeIsSinceTheLastLook) {
  meet(QoS(10).deadline(period));
  publish();
  std::int32_t sum = 0;
  for (int i = 0; i < 4; ++i) {
    wait_for(1);
    const DeadlineMissedInfo info = subscription->get_deadline_missed_status();
    sum += info.total_count_change;
    EXPECT_EQ(sum, info.total_count);
  }
}

TEST_F(Deadline, IsNotMissedWhileMessagesCome) {
  meet(QoS(10).deadline(1h));
  for (int i = 0; i < 3; ++i) {
    publish();
    wait_for(1);
  }
  EXPECT_EQ(publisher->get_deadline_missed_status().total_count, 0);
  EXPECT_EQ(subscription->get_deadline_missed_status().total_count, 0);
}

TEST_F(Deadline, AnyPublisherKeepsThatOfASubscription) {
  meet(QoS(10).deadline(1h));
  const auto other = node.create_publisher<Number>(own("topic"), QoS(10).deadline(period));
  ASSERT_TRUE(test::eventually([&] { return other->get_linked_subscription_count() == 1; }));
  ASSERT_TRUE(other->publish(other->borrow_loaned_message()));
  EXPECT_TRUE(
      test::eventually([&] { return other->get_deadline_missed_status().total_count >= 2; }));
  EXPECT_EQ(subscription->get_deadline_missed_status().total_count, 0);
  EXPECT_EQ(publisher->get_deadline_missed_status().total_count, 0) << "it published nothing";
}

TEST_F(Deadline, OfAnEndedPublisherGoesOn) {
  meet(QoS(10).deadline(period));
  publish();
  publisher.reset();
  ASSERT_TRUE(test::eventually([&] { return subscription->get_linked_publisher_count() == 0; }));
  wait_for(2);
  EXPECT_TRUE(has_missed_all([&] { return subscription->get_deadline_missed_status(); }));
  while (subscription->take()) {
  }
  wait_for(2);
  EXPECT_TRUE(has_missed_all([&] { return subscription->get_deadline_missed_status(); }));
}

TEST_F(Deadline, CallbacksAreCalledWithoutAnyMessage) {
  std::int32_t offered = 0, requested = 0;
  meet(QoS(10).deadline(period),
       PublisherOptions().deadline_callback(
           [&](DeadlineMissedInfo& info) { offered += info.total_count_change; }),
       SubscriptionOptions().deadline_callback(
           [&](DeadlineMissedInfo& info) { requested += info.total_count_change; }));
  SingleThreadedExecutor executor;
  executor.add_node(node);
  executor.spin_some();
  EXPECT_EQ(offered + requested, 0);
  publish();
  while (offered < 4 || requested < 4) executor.spin_once();
  EXPECT_LE(std::max(offered, requested), (Clock::now() - published_after) / period);
}

}  // namespace
}  // namespace agnocast
