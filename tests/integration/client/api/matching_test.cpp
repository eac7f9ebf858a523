// SPDX-License-Identifier: Apache-2.0
//
// Goal: once a creation has returned, both sides count each other, and a subscription gets
// everything that is published afterwards, though its process has not linked yet.
// Method: publishers and subscriptions in this process, with the real daemon. Nothing is waited for
// between a creation and what is asked or published next.

#include <agnocast/agnocast.hpp>
#include <tests/integration/client/programs/second_process.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gmock/gmock.h>

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using test::eventually;
using test::Number;
using test::qos_of;
using Values = std::vector<std::uint64_t>;

class Matching : public test::SuiteDaemon {
 protected:
  static void publish(Publisher<Number>& publisher, std::uint64_t value) {
    auto loan = publisher.borrow_loaned_message();
    loan->value = value;
    ASSERT_TRUE(publisher.publish(std::move(loan)));
  }
  /// Takes until `count` messages are there.
  static Values taken(Subscription<Number>& subscription, std::size_t count) {
    Values values;
    EXPECT_TRUE(eventually([&] {
      while (const auto message = subscription.take()) values.push_back(message->value);
      return values.size() >= count;
    }));
    return values;
  }

  Node node{own("node")};
};

TEST_F(Matching, EndpointsCountAsSoonAsTheyAreCreated) {
  const auto publisher = node.create_publisher<Number>(own("topic"), 1);
  EXPECT_EQ(publisher->get_subscription_count(), 0u);
  for (int i = 0; i < 100; ++i) {
    {
      const auto subscription = node.create_subscription<Number>(own("topic"), 1);
      ASSERT_EQ(publisher->get_subscription_count(), 1u);
      ASSERT_EQ(subscription->get_publisher_count(), 1u);
      const auto another = node.create_publisher<Number>(own("topic"), 1);
      ASSERT_EQ(another->get_subscription_count(), 1u);
      ASSERT_EQ(subscription->get_publisher_count(), 2u);
      const auto elsewhere = node.create_subscription<Number>(own("other"), 1);
      ASSERT_EQ(elsewhere->get_publisher_count(), 0u);
    }
    // What was destroyed leaves its topic a moment later.
    ASSERT_TRUE(eventually([&] { return publisher->get_subscription_count() == 0; }));
  }
}

TEST_F(Matching, OnlyEndpointsWhoseQosMatchesCount) {
  struct Case {
    const char *offered, *requested;
    std::size_t matches;
  };
  constexpr Case cases[] = {{"1rv", "1bv", 1},       {"1bv", "1rv", 0},      {"1rt", "1rt", 1},
                            {"1rv", "1rt", 0},       {"1rvd1", "1rvd2", 1},  {"1rvd2", "1rvd1", 0},
                            {"1rv", "1rvd1", 0},     {"1rvm", "1rv", 1},     {"1rv", "1rvm", 0},
                            {"1rvml1", "1rvml2", 1}, {"1rvml2", "1rvml1", 0}};
  for (const Case& one : cases) {
    SCOPED_TRACE(std::string(one.offered) + " " + one.requested);
    const std::string topic = own("topic") + std::to_string(&one - cases);
    const auto publisher = node.create_publisher<Number>(topic, qos_of(one.offered));
    const auto subscription = node.create_subscription<Number>(topic, qos_of(one.requested));
    EXPECT_EQ(publisher->get_subscription_count(), one.matches);
    EXPECT_EQ(subscription->get_publisher_count(), one.matches);
  }
  const auto remote = node.create_subscription<Number>(
      own("local"), 1, SubscriptionOptions().ignore_local_publications());
  const auto publisher = node.create_publisher<Number>(own("local"), 1);
  EXPECT_EQ(publisher->get_subscription_count(), 0u);
  EXPECT_EQ(remote->get_publisher_count(), 0u);
}

TEST_F(Matching, WhatIsPublishedRightAfterACreationArrives) {
  const auto publisher = node.create_publisher<Number>(own("topic"), 5);
  std::uint64_t value = 0;
  for (int i = 0; i < 200 && !HasFailure(); ++i) {
    publish(*publisher, ++value);  // before: not wanted
    const auto subscription = node.create_subscription<Number>(own("topic"), 3);
    publish(*publisher, value + 1);
    publish(*publisher, value + 2);
    EXPECT_THAT(taken(*subscription, 2), testing::ElementsAre(value + 1, value + 2));
    EXPECT_EQ(subscription->get_lost_count(), 0u);
    value += 2;
  }
}

TEST_F(Matching, HistoryAndWhatFollowsArriveInOrder) {
  const auto publisher = node.create_publisher<Number>(own("topic"), qos_of("2rt"));
  std::uint64_t value = 0;
  for (int i = 0; i < 100 && !HasFailure(); ++i) {
    for (int k = 0; k < 3; ++k) publish(*publisher, ++value);
    const auto subscription = node.create_subscription<Number>(own("topic"), qos_of("4rt"));
    publish(*publisher, value + 1);
    publish(*publisher, value + 2);
    EXPECT_THAT(taken(*subscription, 4),
                testing::ElementsAre(value - 1, value, value + 1, value + 2));
    value += 2;
  }
}

TEST_F(Matching, OfMoreThanItsDepthThatIsPublishedMeanwhileASubscriptionGetsTheNewest) {
  const auto publisher = node.create_publisher<Number>(own("topic"), 5);
  std::uint64_t value = 0;
  for (int i = 0; i < 50 && !HasFailure(); ++i) {
    const auto subscription = node.create_subscription<Number>(own("topic"), 2);
    for (int k = 0; k < 20; ++k) publish(*publisher, ++value);
    const Values values = taken(*subscription, 2);
    ASSERT_GE(values.size(), 2u);
    EXPECT_EQ(values.back(), value);
  }
}

}  // namespace
}  // namespace agnocast
