// SPDX-License-Identifier: Apache-2.0
//
// Goal: a wait set wakes for each kind of event of an endpoint and reports what has changed since
// it was taken, once. Method: endpoints of this process and the real daemon; waits without an end,
// so that an event that wakes nobody hangs the test.

#include <ros2/rmw_agnocast_cpp/core/events.hpp>
#include <ros2/rmw_agnocast_cpp/core/topics.hpp>

#include <tests/integration/rmw/messages.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <thread>

namespace agnocast::rmw {
namespace {

using namespace std::chrono_literals;
using test::eventually;

class RmwEvents : public test::SuiteDaemon {
 protected:
  std::unique_ptr<TopicPublisher> publisher(const QoS& qos) {
    return valued(TopicPublisher::create(node, topic, cpp_support<Everything>(), qos));
  }
  std::unique_ptr<TopicSubscription> subscription(const QoS& qos) {
    return valued(TopicSubscription::create(node, topic, cpp_support<Everything>(), qos, false));
  }
  /// Waits for this event, as long as it takes.
  void expect(const Readable& event) {
    const auto woken = set.wait({}, {&event}, std::nullopt);
    ASSERT_TRUE(woken) << woken.error().what;
    EXPECT_TRUE(set.is_readable_ready(0));
  }
  bool is_ready(const Readable& event) { return set.wait({}, {&event}, 0ns).value(); }

  const NodeName node{"node", "/" + own("space")};
  const std::string topic = "/" + own("topic");
  WaitPool pool;
  WaitSet set{pool};
};

TEST_F(RmwEvents, TellWhichPublishersAreAlive) {
  const auto reader = subscription(QoS(1));
  auto& event = reader->events().liveliness_changed;
  EXPECT_FALSE(is_ready(event));
  auto first = publisher(QoS(1));
  expect(event);
  EXPECT_TRUE(is_ready(event)) << "until it is taken";
  LivelinessChangedInfo now = event.take();
  EXPECT_EQ(now.alive_count, 1);
  EXPECT_EQ(now.alive_count_change, 1);
  EXPECT_FALSE(is_ready(event));

  std::unique_ptr<TopicPublisher> second;
  std::thread comes([&] { second = publisher(QoS(1)); });
  expect(event);
  comes.join();
  first.reset();
  ASSERT_TRUE(eventually([&] { return is_ready(event); }));
  ASSERT_TRUE(eventually([&] {
    const LivelinessChangedInfo taken = event.take();
    now.alive_count = taken.alive_count;
    now.alive_count_change += taken.alive_count_change;
    return now.alive_count_change == 1;  // two came, one went
  }));
  EXPECT_EQ(now.alive_count, 1);
}

TEST_F(RmwEvents, TellBothSidesOfAMissedDeadline) {
  const auto writer = publisher(QoS(1).deadline(50ms));
  const auto reader = subscription(QoS(1).deadline(50ms));
  ASSERT_TRUE(eventually([&] { return reader->endpoint().get_publisher_count() == 1; }));
  const Everything sent{};
  ASSERT_TRUE(writer->publish(&sent));
  Everything message;
  MessageInfo info;
  ASSERT_TRUE(eventually([&] { return reader->take(&message, info); }));
  expect(writer->events().deadline_missed);
  EXPECT_GE(writer->events().deadline_missed.take().total_count_change, 1);
  expect(reader->events().deadline_missed);
  const DeadlineMissedInfo first = reader->events().deadline_missed.take();
  EXPECT_GE(first.total_count_change, 1);
  expect(reader->events().deadline_missed);
  EXPECT_GT(reader->events().deadline_missed.take().total_count, first.total_count);
}

TEST_F(RmwEvents, TellBothSidesOfAnIncompatibleQos) {
  const auto writer = publisher(QoS(1).best_effort());
  const auto reader = subscription(QoS(1).reliable());
  expect(writer->events().incompatible_qos);
  expect(reader->events().incompatible_qos);
  const IncompatibleQosInfo now = reader->events().incompatible_qos.take();
  EXPECT_EQ(now.total_count, 1);
  EXPECT_EQ(now.total_count_change, 1);
  EXPECT_EQ(now.last_policy_kind, QosPolicyKind::reliability);
  EXPECT_EQ(writer->events().incompatible_qos.take().total_count, 1);
  EXPECT_EQ(reader->events().incompatible_qos.take().total_count_change, 0);
}

TEST_F(RmwEvents, OnlyWhatTheTimeChangesIsDue) {
  const auto never = Readable::Clock::time_point::max();
  const auto writer = publisher(QoS(1).deadline(50ms));
  const auto reader = subscription(QoS(1).deadline(50ms));
  EXPECT_LT(writer->events().deadline_missed.look_due(), never);
  EXPECT_LT(reader->events().deadline_missed.look_due(), never);
  EXPECT_EQ(writer->events().incompatible_qos.look_due(), never);
  EXPECT_EQ(reader->events().incompatible_qos.look_due(), never);
  EXPECT_EQ(reader->events().message_lost.look_due(), never);
}

TEST_F(RmwEvents, TellOfALeaseThatEnds) {
  const auto writer =
      publisher(QoS(1).liveliness(Liveliness::manual_by_topic).liveliness_lease_duration(50ms));
  const auto reader = subscription(QoS(1));
  ASSERT_TRUE(writer->endpoint().assert_liveliness());
  expect(writer->events().liveliness_lost);
  EXPECT_GE(writer->events().liveliness_lost.take().total_count, 1);
  ASSERT_TRUE(eventually([&] {
    const LivelinessChangedInfo now = reader->events().liveliness_changed.take();
    return now.alive_count == 0 && now.not_alive_count == 1;
  }));
}

TEST_F(RmwEvents, TellOfLostMessages) {
  const auto reader = subscription(QoS(2));
  const auto writer = publisher(QoS(2));
  ASSERT_TRUE(eventually([&] { return writer->endpoint().get_linked_subscription_count() == 1; }));
  const Everything sent{};
  for (int i = 0; i < 5; ++i) ASSERT_TRUE(writer->publish(&sent));
  Everything message;
  MessageInfo info;
  ASSERT_TRUE(eventually([&] { return reader->take(&message, info); }));
  expect(reader->events().message_lost);
  const MessageLostInfo lost = reader->events().message_lost.take();
  EXPECT_EQ(lost.total_count, 3u);
  EXPECT_EQ(lost.total_count_change, 3u);
  EXPECT_FALSE(is_ready(reader->events().message_lost));
}

}  // namespace
}  // namespace agnocast::rmw
