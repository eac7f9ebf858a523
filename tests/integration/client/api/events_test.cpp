// SPDX-License-Identifier: Apache-2.0
//
// Goal: an endpoint learns which peers matched it, left or died, and which could not match and
// why, whichever side came first.
// Method: the public interface with the real daemon; the other side is a second process that ends
// or is killed. The test polls statuses; a background executor or the test's own runs callbacks.

#include <agnocast/agnocast.hpp>
#include <tests/integration/client/programs/second_process.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/spun.hpp>
#include <tests/support/processes/suite_daemon.hpp>
#include <tests/support/wire/foreign_socket.hpp>

#include <gmock/gmock.h>

#include <signal.h>
#include <unistd.h>

#include <cstdlib>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

namespace agnocast {
namespace {

using test::eventually;
using test::Number;
using test::qos_of;
using test::SecondProcess;
using test::Spun;

class Events : public test::SuiteDaemon {};

/// A list that callbacks fill.
template <class Info>
struct Told {
  std::mutex mutex;
  std::vector<Info> infos;
  std::vector<std::thread::id> threads;
  void add(const Info& info) {
    const std::lock_guard lock(mutex);
    infos.push_back(info);
    threads.push_back(std::this_thread::get_id());
  }
  /// Returns the sum over all changes so far.
  template <class Member>
  auto sum(Member member) {
    const std::lock_guard lock(mutex);
    decltype(Info().*member + 0) total = 0;
    for (const Info& info : infos) total += info.*member;
    return total;
  }
  Info last() {
    const std::lock_guard lock(mutex);
    return infos.empty() ? Info() : infos.back();
  }
};

TEST_F(Events, AnEndpointLearnsThatTheDaemonIsAwayAndBack) {
  Spun<Node> node(own("node"));
  Told<ConnectionInfo> told, also_told;
  auto subscription = node.create_subscription<Number>(
      own("topic"), 1, [](const ipc_shared_ptr<const Number>&) {},
      SubscriptionOptions().connection_callback([&](ConnectionInfo& info) { told.add(info); }));
  auto publisher = node.create_publisher<Number>(
      own("topic"), 1,
      PublisherOptions().connection_callback([&](ConnectionInfo& info) { also_told.add(info); }));
  EXPECT_EQ(connection_state(), ConnectionState::connected);
  ::kill(daemon->pid(), SIGSTOP);
  ASSERT_TRUE(test::end_connection(::getpid()));
  EXPECT_TRUE(eventually([&] { return told.last().state == ConnectionState::reconnecting; }));
  EXPECT_TRUE(eventually([&] { return also_told.last().state == ConnectionState::reconnecting; }));
  EXPECT_EQ(connection_state(), ConnectionState::reconnecting);
  ::kill(daemon->pid(), SIGCONT);
  EXPECT_TRUE(eventually([&] { return told.last().state == ConnectionState::connected; }));
  EXPECT_TRUE(eventually([&] { return also_told.last().state == ConnectionState::connected; }));
  EXPECT_EQ(told.infos.size(), 2u);
  EXPECT_EQ(orphan_reason(), Errc::ok);
}

TEST_F(Events, ASubscriptionIsNotifiedOfPublishersThatComeLeaveAndDie) {
  Spun<Node> node(own("node"));
  Told<MatchedInfo> told;
  auto subscription = node.create_subscription<Number>(
      own("topic"), 1, [](const ipc_shared_ptr<const Number>&) {},
      SubscriptionOptions().matched_callback([&](MatchedInfo& info) { told.add(info); }));
  SecondProcess first({"publish", own("topic"), "1rv", "0"});
  EXPECT_TRUE(eventually([&] { return told.last().current_count == 1; }));
  SecondProcess second({"publish", own("topic"), "1rv", "0"});
  EXPECT_TRUE(eventually([&] { return told.last().current_count == 2; }));
  EXPECT_EQ(first.end(), 0);
  EXPECT_TRUE(eventually([&] { return told.last().current_count == 1; }));
  second.kill();
  EXPECT_TRUE(eventually([&] { return told.last().current_count == 0; }));
  EXPECT_EQ(told.last().total_count, 2u);
  EXPECT_EQ(told.sum(&MatchedInfo::total_count_change), 2u);
  EXPECT_EQ(told.sum(&MatchedInfo::current_count_change), 0);
  const MatchedInfo status = subscription->get_matched_status();
  EXPECT_EQ(status.total_count, 2u);
  EXPECT_EQ(status.total_count_change, 2u) << "callbacks do not reset the status's changes";
  EXPECT_EQ(status.current_count, 0u);
  EXPECT_EQ(subscription->get_matched_status().total_count_change, 0u);
}

TEST_F(Events, APublisherIsNotifiedOfSubscriptionsThatComeLeaveAndDie) {
  Spun<Node> node(own("node"));
  Told<MatchedInfo> told;
  SecondProcess first({"subscribe", own("topic"), "1rv"});
  auto publisher = node.create_publisher<Number>(
      own("topic"), 1,
      PublisherOptions().matched_callback([&](MatchedInfo& info) { told.add(info); }));
  EXPECT_TRUE(eventually([&] { return told.last().current_count == 1; }));
  SecondProcess second({"subscribe", own("topic"), "1rv"});
  EXPECT_TRUE(eventually([&] { return told.last().current_count == 2; }));
  EXPECT_EQ(first.end(), 0);
  EXPECT_TRUE(eventually([&] { return told.last().current_count == 1; }));
  second.kill();
  EXPECT_TRUE(eventually([&] { return told.last().current_count == 0; }));
  EXPECT_EQ(publisher->get_matched_status().total_count, 2u);
}

TEST_F(Events, APublisherCountsEachSubscriptionAlsoOneThatEndsAtOnce) {
  Spun<Node> node(own("node"));
  Told<MatchedInfo> told;
  auto publisher = node.create_publisher<Number>(
      own("topic"), 1,
      PublisherOptions().matched_callback([&](MatchedInfo& info) { told.add(info); }));
  constexpr std::uint64_t count = 240;
  for (std::uint64_t i = 0; i < count; ++i) node.create_subscription<Number>(own("topic"), 1);
  EXPECT_TRUE(eventually([&] { return publisher->get_matched_status().total_count == count; }))
      << publisher->get_matched_status().total_count;
  EXPECT_TRUE(eventually([&] { return publisher->get_matched_status().current_count == 0; }));
  EXPECT_TRUE(eventually([&] { return told.sum(&MatchedInfo::total_count_change) == count; }));
  EXPECT_TRUE(eventually([&] { return told.sum(&MatchedInfo::current_count_change) == 0; }));
}

struct Case {
  const char* offered;
  const char* requested;
  QosPolicyKind policy;
};
constexpr Case cases[] = {
    {"1bv", "1rv", QosPolicyKind::reliability},
    {"1rv", "1rt", QosPolicyKind::durability},
    {"1bt", "1rt", QosPolicyKind::reliability},
    {"1bv", "1rt", QosPolicyKind::reliability},
    {"1rvd2", "1rvd1", QosPolicyKind::deadline},
    {"1rv", "1rvmd1", QosPolicyKind::deadline},
    {"1rv", "1rvm", QosPolicyKind::liveliness},
    {"1rvml2", "1rvl1", QosPolicyKind::liveliness_lease_duration},
};

TEST_F(Events, BothSidesLearnTheIncompatiblePolicyWhicheverComesFirst) {
  Node node(own("node"));
  for (const Case& pair : cases) {
    const std::string topic = own("topic") + pair.offered + pair.requested;
    {
      SCOPED_TRACE(topic + ": a publisher here, then a subscription there");
      auto publisher = node.create_publisher<Number>(topic, qos_of(pair.offered));
      SecondProcess other({"subscribe", topic, pair.requested});
      IncompatibleQosInfo info;
      EXPECT_TRUE(eventually([&] {
        info = publisher->get_incompatible_qos_status();
        return info.total_count_change == 1;
      }));
      EXPECT_EQ(info.total_count, 1);
      EXPECT_EQ(info.last_policy_kind, pair.policy);
      EXPECT_EQ(publisher->get_matched_status().total_count, 0u);

      auto late = node.create_publisher<Number>(topic, qos_of(pair.offered));
      EXPECT_TRUE(eventually([&] { return late->get_incompatible_qos_status().total_count == 1; }))
          << "created when the subscription already exists";
    }
    {
      SCOPED_TRACE(topic + ": a subscription here, then a publisher there");
      const std::string reverse = topic + "_reverse";
      auto subscription = node.create_subscription<Number>(reverse, qos_of(pair.requested));
      SecondProcess other({"publish", reverse, pair.offered, "0"});
      IncompatibleQosInfo info;
      EXPECT_TRUE(eventually([&] {
        info = subscription->get_incompatible_qos_status();
        return info.total_count_change == 1;
      }));
      EXPECT_EQ(info.last_policy_kind, pair.policy);
      auto late = node.create_subscription<Number>(reverse, qos_of(pair.requested));
      EXPECT_TRUE(eventually([&] { return late->get_incompatible_qos_status().total_count == 1; }));
    }
  }
}

TEST_F(Events, CallbacksRunInTheExecutorAndReportEarlierEvents) {
  Node node(own("node"));
  SingleThreadedExecutor executor;
  executor.add_node(node);
  SecondProcess other({"publish", own("topic"), "1bv", "0"});
  auto witness = node.create_subscription<Number>(own("topic"), qos_of("1bv"));
  ASSERT_TRUE(eventually([&] { return witness->get_linked_publisher_count() == 1; }));
  Told<IncompatibleQosInfo> told;
  auto subscription = node.create_subscription<Number>(
      own("topic"), qos_of("1rv"),
      SubscriptionOptions().incompatible_qos_callback(
          [&](QOSRequestedIncompatibleQoSInfo& info) { told.add(info); }));
  executor.spin_once();
  ASSERT_EQ(told.infos.size(), 1u);
  EXPECT_EQ(told.infos[0].total_count_change, 1);
  EXPECT_EQ(told.infos[0].last_policy_kind, QosPolicyKind::reliability);
  EXPECT_EQ(told.threads[0], std::this_thread::get_id());
  executor.spin_some();
  EXPECT_EQ(told.infos.size(), 1u) << "notified once";
}

TEST_F(Events, APresentEndpointIsNotifiedOfAnotherType) {
  Spun<Node> node(own("node"));
  Told<IncompatibleTypeInfo> told;
  auto publisher =
      node.create_publisher<Number>(own("topic"), 1,
                                    PublisherOptions().incompatible_type_callback(
                                        [&](IncompatibleTypeInfo& info) { told.add(info); }));
  auto subscription = node.create_subscription<Number>(own("topic"), 1);
  SecondProcess other({"other_type", own("topic")});
  EXPECT_TRUE(eventually([&] { return told.last().total_count == 1; }));
  EXPECT_TRUE(
      eventually([&] { return subscription->get_type_mismatch_status().total_count == 1; }));
  EXPECT_EQ(publisher->get_type_mismatch_status().total_count_change, 1);
  EXPECT_EQ(publisher->get_type_mismatch_status().total_count_change, 0);
  EXPECT_EQ(publisher->get_incompatible_qos_status().total_count, 0);
}

TEST_F(Events, AnExceptionOfAnEventCallbackIsHandledLikeAnyOther) {
  Node node(own("node"));
  auto publisher = node.create_publisher<Number>(
      own("topic"), 1, PublisherOptions().matched_callback([](MatchedInfo&) { throw 1; }));
  auto subscription = node.create_subscription<Number>(own("topic"), 1);
  {
    BackgroundExecutor background;
    background.add_node(node);
    EXPECT_TRUE(eventually([&] { return publisher->get_callback_exception_count() == 1; }));
  }
  SingleThreadedExecutor executor;
  executor.add_node(node);
  auto second = node.create_subscription<Number>(own("topic"), 1);
  EXPECT_THROW(executor.spin(), int);
}

TEST_F(Events, ASubscriptionMayIgnoreThePublishersOfItsProcess) {
  Node node(own("node"));
  const QoS qos = qos_of("10rv");
  const auto all = node.create_subscription<Number>(own("topic"), qos);
  const auto remote = node.create_subscription<Number>(
      own("topic"), qos, SubscriptionOptions().ignore_local_publications());
  const auto publisher = node.create_publisher<Number>(own("topic"), qos);
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  SecondProcess other({"publish", own("topic"), "10rv", "3"});
  ASSERT_TRUE(eventually([&] { return remote->get_linked_publisher_count() == 1; }));
  EXPECT_EQ(all->get_linked_publisher_count(), 2u);
  auto loan = publisher->borrow_loaned_message();
  loan->value = 99;
  ASSERT_TRUE(publisher->publish(std::move(loan)));
  std::vector<std::uint64_t> by_all, by_remote;
  ASSERT_TRUE(eventually([&] {
    while (const auto message = all->take()) by_all.push_back(message->value);
    while (const auto message = remote->take()) by_remote.push_back(message->value);
    return by_all.size() == 4 && by_remote.size() == 3;
  }));
  EXPECT_THAT(by_all, testing::UnorderedElementsAre(1, 2, 3, 99));
  EXPECT_THAT(by_remote, testing::ElementsAre(1, 2, 3));
  EXPECT_EQ(publisher->get_linked_subscription_count(), 1u);
  EXPECT_EQ(publisher->get_incompatible_qos_status().total_count, 0);
}

}  // namespace
}  // namespace agnocast
