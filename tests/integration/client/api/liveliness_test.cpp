// SPDX-License-Identifier: Apache-2.0
//
// Goal: a publisher with manual liveliness is alive while it publishes or asserts that within its
// lease, and both sides are notified when that changes; a dead process takes its publishers along
// at once. Method: publishers and subscriptions in this process, one in another that is killed,
// with the real daemon. A lease of milliseconds is over when somebody has waited, one of an hour is
// not.

#include <agnocast/agnocast.hpp>
#include <tests/integration/client/programs/second_process.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gtest/gtest.h>

#include <chrono>
#include <thread>

namespace agnocast {
namespace {

using namespace std::chrono_literals;
using std::chrono::nanoseconds;
using test::eventually;
using test::Number;

class LivelinessTest : public test::SuiteDaemon {
 protected:
  static constexpr nanoseconds lease = 20ms;
  static QoS manual(nanoseconds time) {
    return QoS(10).liveliness(Liveliness::manual_by_topic).liveliness_lease_duration(time);
  }
  void meet(const QoS& qos, const PublisherOptions& of_publisher = {},
            const SubscriptionOptions& of_subscription = {}) {
    publisher = node.create_publisher<Number>(own("topic"), qos, of_publisher);
    subscription = node.create_subscription<Number>(own("topic"), qos, of_subscription);
    ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
    ASSERT_TRUE(eventually([&] { return subscription->get_linked_publisher_count() == 1; }));
  }
  bool counts(int alive, int not_alive) {
    const LivelinessChangedInfo info = subscription->get_liveliness_changed_status();
    return info.alive_count == alive && info.not_alive_count == not_alive;
  }

  Node node{own("node")};
  Publisher<Number>::SharedPtr publisher;
  PollingSubscriber<Number>::SharedPtr subscription;
};

TEST_F(LivelinessTest, AutomaticLastsAsLongAsThePublisher) {
  meet(QoS(10).liveliness_lease_duration(lease));
  std::this_thread::sleep_for(2 * lease);
  const LivelinessChangedInfo info = subscription->get_liveliness_changed_status();
  EXPECT_EQ(info.alive_count, 1);
  EXPECT_EQ(info.alive_count_change, 1);
  EXPECT_EQ(info.not_alive_count, 0);
  EXPECT_EQ(publisher->get_liveliness_lost_status().total_count, 0);
  publisher.reset();
  EXPECT_TRUE(eventually([&] { return counts(0, 0); }));
}

TEST_F(LivelinessTest, ASilentPublisherIsLostOnce) {
  meet(manual(lease));
  for (int i = 0; i < 3; ++i) {
    std::this_thread::sleep_for(lease + 1ms);
    const LivelinessLostInfo lost = publisher->get_liveliness_lost_status();
    EXPECT_EQ(lost.total_count, 1);
    EXPECT_EQ(lost.total_count_change, i == 0 ? 1 : 0);
    const LivelinessChangedInfo changed = subscription->get_liveliness_changed_status();
    EXPECT_EQ(changed.alive_count, 0);
    EXPECT_EQ(changed.not_alive_count, 1);
    EXPECT_EQ(changed.not_alive_count_change, i == 0 ? 1 : 0);
  }
  publisher.reset();
  EXPECT_TRUE(eventually([&] { return counts(0, 0); })) << "it does not count at all";
}

TEST_F(LivelinessTest, AssertingAndPublishingShowThatItIsAlive) {
  meet(manual(500ms));
  // Beyond the lease, so that the next look finds it alive only if that was shown.
  const auto be_silent = [&] {
    std::this_thread::sleep_for(501ms);
    EXPECT_TRUE(counts(0, 1));
  };
  be_silent();
  EXPECT_TRUE(eventually([&] { return publisher->assert_liveliness() && counts(1, 0); }));
  be_silent();
  EXPECT_TRUE(eventually(
      [&] { return publisher->publish(publisher->borrow_loaned_message()) && counts(1, 0); }));
}

TEST_F(LivelinessTest, IsNotLostWithinItsLease) {
  meet(manual(1h));
  std::this_thread::sleep_for(lease);
  EXPECT_EQ(publisher->get_liveliness_lost_status().total_count, 0);
  EXPECT_TRUE(counts(1, 0));
}

TEST_F(LivelinessTest, ADeathIsKnownBeforeTheLeaseIsOver) {
  test::SecondProcess other({"publish", own("topic"), "1rvml3600", "0"});
  subscription = node.create_subscription<Number>(own("topic"), manual(3600s));
  EXPECT_TRUE(eventually([&] { return counts(1, 0); }));
  other.kill();
  EXPECT_TRUE(eventually([&] { return counts(0, 0); }));
}

TEST_F(LivelinessTest, EachPublisherIsCounted) {
  meet(manual(lease));
  const auto brief = node.create_publisher<Number>(own("topic"), manual(1ms));
  const auto other = node.create_publisher<Number>(own("topic"), manual(lease));
  EXPECT_TRUE(eventually([&] { return subscription->get_linked_publisher_count() == 3; }));
  EXPECT_TRUE(eventually([&] { return counts(0, 3); }));
  EXPECT_TRUE(eventually([&] { return other->assert_liveliness() && counts(1, 2); }));
}

TEST_F(LivelinessTest, CallbacksAreCalledWithoutAnyMessage) {
  int lost = 0, alive = -1, not_alive = -1;
  meet(manual(lease), PublisherOptions().liveliness_callback([&](LivelinessLostInfo& info) {
    lost += info.total_count_change;
  }),
       SubscriptionOptions().liveliness_callback([&](LivelinessChangedInfo& info) {
         alive = info.alive_count;
         not_alive = info.not_alive_count;
       }));
  SingleThreadedExecutor executor;
  executor.add_node(node);
  while (lost == 0 || not_alive != 1) executor.spin_once();
  EXPECT_EQ(alive, 0);
  // Until looks within a lease have seen it: nobody waits for one that came and went unseen.
  while (alive != 1 || lost < 2) {
    EXPECT_TRUE(publisher->assert_liveliness());
    executor.spin_once(2 * lease);
  }
}

}  // namespace
}  // namespace agnocast
