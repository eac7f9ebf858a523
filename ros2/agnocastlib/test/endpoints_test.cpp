// SPDX-License-Identifier: Apache-2.0
//
// Publishers and subscriptions as code for the kernel-module system writes them.

#include "common.hpp"

#include <std_srvs/srv/trigger.hpp>

#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cstring>
#include <functional>
#include <set>

namespace agnocastlib {
namespace {

class EndpointsTest : public NodeTest {};

/// A class as people write it.
struct Listener {
  std::string heard;
  void callback(const agnocast::ipc_shared_ptr<String>& message) { heard += message->data; }
};

TEST_F(EndpointsTest, CallbacksTakeTheMessageInEveryForm) {
  std::set<std::string> heard;
  Listener listener;
  std::vector<std::shared_ptr<agnocast::SubscriptionBase>> subscriptions;
  const auto add = [&](auto callback) {
    subscriptions.push_back(
        agnocast::create_subscription<String>(node_.get(), "topic", 10, std::move(callback)));
  };
  add([&](const agnocast::ipc_shared_ptr<String>& m) { heard.insert("reference " + m->data); });
  add([&](agnocast::ipc_shared_ptr<String>&& m) { heard.insert("rvalue " + m->data); });
  add([&](agnocast::ipc_shared_ptr<const String> m) { heard.insert("const value " + m->data); });
  add([&](const agnocast::ipc_shared_ptr<const String>& m) { heard.insert("const " + m->data); });
  add(std::bind(&Listener::callback, &listener, std::placeholders::_1));
  const auto publisher = agnocast::create_publisher<String>(node_.get(), "topic", 10);
  ASSERT_TRUE(spin_until([&] { return publisher->get_linked_subscription_count() == 5; }));
  publish(*publisher, "1");
  EXPECT_TRUE(spin_until([&] { return heard.size() == 4 && !listener.heard.empty(); }));
  EXPECT_THAT(heard,
              testing::UnorderedElementsAre("reference 1", "rvalue 1", "const value 1", "const 1"));
  EXPECT_EQ(listener.heard, "1");
  EXPECT_EQ(subscriptions.front()->get_publisher_count(), 1u);
}

TEST_F(EndpointsTest, EndpointsAreMadeByConstructorsToo) {
  std::string heard;
  agnocast::Subscription<String> subscription(
      node_.get(), "topic", rclcpp::QoS(1), [&](Message message) { heard = message->data; },
      agnocast::SubscriptionOptions{});
  agnocast::Publisher<String> publisher(node_.get(), "topic", rclcpp::QoS(1),
                                        agnocast::PublisherOptions{});
  EXPECT_STREQ(publisher.get_topic_name(), "/topic");
  ASSERT_TRUE(spin_until([&] { return publisher.get_linked_subscription_count() == 1; }));
  publish(publisher, "text");
  EXPECT_TRUE(spin_until([&] { return heard == "text"; }));
}

TEST_F(EndpointsTest, SubscriptionsOfThisProcessAreCountedApart) {
  const auto publisher = agnocast::create_publisher<String>(node_.get(), "topic", 1);
  EXPECT_EQ(publisher->get_subscription_count(), 0u);
  EXPECT_EQ(publisher->get_intra_subscription_count(), 0u);
  auto polling = agnocast::create_subscription<String>(node_.get(), "topic", 1);
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  EXPECT_EQ(publisher->get_subscription_count(), 0u) << "none in another process";
  polling.reset();
  EXPECT_TRUE(eventually([&] { return publisher->get_intra_subscription_count() == 0; }));
}

TEST_F(EndpointsTest, EachPublisherHasAGidOfItsOwn) {
  std::vector<agnocast::Publisher<String>::SharedPtr> publishers;
  std::set<std::string> gids;
  for (int i = 0; i < 20; ++i) {
    publishers.push_back(agnocast::create_publisher<String>(node_.get(), "topic", 1));
    const rmw_gid_t& gid = publishers.back()->get_gid();
    EXPECT_STREQ(gid.implementation_identifier, "agnocast");
    gids.emplace(reinterpret_cast<const char*>(gid.data), sizeof gid.data);
  }
  EXPECT_EQ(gids.size(), publishers.size());
}

TEST_F(EndpointsTest, PublicationsOfTheProcessAreIgnoredOnRequest) {
  agnocast::SubscriptionOptions options;
  options.ignore_local_publications = true;
  agnocast::TakeSubscription<String> ignores(node_.get(), "topic", rclcpp::QoS(10), options);
  agnocast::TakeSubscription<String> hears(node_.get(), "topic", rclcpp::QoS(10));
  const auto publisher = agnocast::create_publisher<String>(node_.get(), "topic", 10);
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  publish(*publisher, "text");
  EXPECT_TRUE(hears.take());
  EXPECT_FALSE(ignores.take());
}

TEST_F(EndpointsTest, TakeGivesTheOldestOrTheSame) {
  const auto subscription =
      std::make_shared<agnocast::TakeSubscription<String>>(node_.get(), "topic", rclcpp::QoS(10));
  const auto publisher = agnocast::create_publisher<String>(node_.get(), "topic", 10);
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  EXPECT_FALSE(subscription->take());
  EXPECT_FALSE(subscription->take(true));
  for (const char* text : {"1", "2", "3", "4"}) publish(*publisher, text);
  EXPECT_EQ(subscription->take()->data, "1");
  EXPECT_EQ(subscription->take()->data, "2");
  EXPECT_EQ(subscription->take(true)->data, "4") << "the newest";
  EXPECT_EQ(subscription->take(true)->data, "4") << "the same again";
  EXPECT_FALSE(subscription->take()) << "nothing unread";
  publish(*publisher, "5");
  EXPECT_EQ(subscription->take()->data, "5");
  EXPECT_EQ(subscription->take(true)->data, "5") << "what take() gave last";
}

TEST_F(EndpointsTest, AsManyMessagesAsTheDepthMayBeHeld) {
  const auto hold_all = [&](const char* topic, std::size_t depth,
                            const agnocast::SubscriptionOptions& options) {
    agnocast::TakeSubscription<String> subscription(node_.get(), topic, rclcpp::QoS(depth),
                                                    options);
    const auto publisher = agnocast::create_publisher<String>(node_.get(), topic, 10);
    EXPECT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
    std::vector<agnocast::ipc_shared_ptr<const String>> held;
    for (int i = 0; i < 200; ++i) {
      publish(*publisher, "text");
      if (auto message = subscription.take()) held.push_back(std::move(message));
    }
    return held.size();
  };
  EXPECT_EQ(hold_all("deep", 100, {}), 100u);
  EXPECT_EQ(hold_all("shallow", 1, {}), 64u);
  agnocast::SubscriptionOptions options;
  options.hold_quota = 3;
  EXPECT_EQ(hold_all("option", 1, options), 3u);
}

/// Runs `body` in a forked child. Returns its exit status; -1: it did not end by itself.
template <class Body>
int status_of_child(Body body) {
  const pid_t child = ::fork();
  if (child == 0) {
    ::alarm(60);  // a lock that a thread of the parent holds is never released
    ::_exit(body());
  }
  int status = 0;
  EXPECT_EQ(::waitpid(child, &status, 0), child);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

TEST_F(EndpointsTest, AForkedChildIsLeftAlone) {
  const auto publisher = agnocast::create_publisher<String>(node_.get(), "topic", 1);
  auto polling = std::make_unique<agnocast::PollingSubscriber<String>>(node_.get(), "topic");
  const auto client = agnocast::create_client<std_srvs::srv::Trigger>(node_.get(), "service");
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  const auto other = agnocast::create_publisher<String>(node_.get(), "other", 1);
  auto foreign = other->borrow_loaned_message();
  EXPECT_EQ(status_of_child([&] {
              const LogLines lines;
              publisher->publish(std::move(foreign));
              if (!lines.with("").empty()) return 1;  // logging writes to the parent's DDS
              if (publisher->get_intra_subscription_count() != 0) return 2;
              polling.reset();
              const auto begin = std::chrono::steady_clock::now();
              if (client->wait_for_service(std::chrono::hours::max())) return 3;
              return std::chrono::steady_clock::now() - begin < 30s ? 0 : 4;
            }),
            0);
  EXPECT_EQ(publisher->get_intra_subscription_count(), 1u) << "the parent goes on";
}

TEST_F(EndpointsTest, PollingGivesTheNewest) {
  const auto subscription =
      agnocast::create_subscription<String>(node_.get(), "topic", rclcpp::QoS(1));
  const auto publisher = agnocast::create_publisher<String>(node_.get(), "topic", 1);
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  EXPECT_FALSE(subscription->take_data());
  publish(*publisher, "1");
  publish(*publisher, "2");
  const agnocast::ipc_shared_ptr<const String> newest = subscription->take_data();
  EXPECT_EQ(newest->data, "2");
  EXPECT_EQ(subscription->takeData().get(), newest.get());
}

TEST_F(EndpointsTest, AGroupExcludesCallbacksOfBothKinds) {
  std::atomic<int> inside{0}, overlaps{0}, ours_heard{0}, theirs_heard{0};
  const auto enter = [&](std::atomic<int>& heard) {
    if (inside.fetch_add(1) != 0) ++overlaps;
    std::this_thread::sleep_for(1ms);
    inside.fetch_sub(1);
    ++heard;
  };
  const auto group = node_->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
  agnocast::SubscriptionOptions options;
  options.callback_group = group;
  const auto ours = agnocast::create_subscription<String>(
      node_.get(), "ours", 100, [&](const Message&) { enter(ours_heard); }, options);
  rclcpp::SubscriptionOptions ros_options;
  ros_options.callback_group = group;
  const auto theirs = node_->create_subscription<String>(
      "theirs", 100, [&](const String&) { enter(theirs_heard); }, ros_options);
  const auto to_ours = agnocast::create_publisher<String>(node_.get(), "ours", 100);
  const auto to_theirs = node_->create_publisher<String>("theirs", 100);
  ASSERT_TRUE(eventually([&] {
    return to_ours->get_linked_subscription_count() == 1 &&
           to_theirs->get_subscription_count() == 1;
  }));
  executor_->remove_node(node_);
  agnocast::MultiThreadedAgnocastExecutor executor(rclcpp::ExecutorOptions(), 2, 2);
  executor.add_node(node_);
  {
    const Spinning spinning(executor);
    for (int i = 0; i < 100; ++i) {
      publish(*to_ours, "text");
      to_theirs->publish(String());
      std::this_thread::sleep_for(1ms);
    }
    EXPECT_TRUE(eventually([&] { return ours_heard == 100 && theirs_heard == 100; }));
  }
  EXPECT_EQ(overlaps, 0);
}

TEST_F(EndpointsTest, AGroupThatNobodyKeepsServesItsSubscription) {
  int heard = 0;
  agnocast::SubscriptionOptions options;
  options.callback_group =
      node_->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
  const std::weak_ptr<rclcpp::CallbackGroup> group = options.callback_group;
  auto subscription = agnocast::create_subscription<String>(
      node_.get(), "topic", 10, [&](const Message&) { ++heard; }, options);
  options.callback_group.reset();
  const auto publisher = agnocast::create_publisher<String>(node_.get(), "topic", 10);
  ASSERT_TRUE(spin_until([&] { return publisher->get_linked_subscription_count() == 1; }));
  publish(*publisher, "text");
  EXPECT_TRUE(spin_until([&] { return heard == 1; }));
  subscription.reset();
  EXPECT_FALSE(group.expired()) << "an executor may wait for it";
}

TEST_F(EndpointsTest, QosIsOverriddenByParameters) {
  const auto node = std::make_shared<rclcpp::Node>(
      "overridden", rclcpp::NodeOptions().parameter_overrides(
                        {{"qos_overrides./latched.publisher.durability", "transient_local"}}));
  agnocast::PublisherOptions options;
  options.qos_overriding_options =
      rclcpp::QosOverridingOptions({rclcpp::QosPolicyKind::Durability});
  const auto publisher =
      agnocast::create_publisher<String>(node.get(), "latched", rclcpp::QoS(1), options);
  EXPECT_TRUE(node->has_parameter("qos_overrides./latched.publisher.durability"));
  publish(*publisher, "late");
  const auto late = agnocast::create_subscription<String>(node_.get(), "latched",
                                                          rclcpp::QoS(1).transient_local());
  EXPECT_TRUE(eventually([&] {
    const auto message = late->take_data();
    return message && message->data == "late";
  }));
}

/// Returns the number in "(29 more since the last line)"; 0: there is none.
std::size_t silent_failures(const std::string& line) {
  const std::size_t begin = line.rfind('(');
  if (begin == std::string::npos || line.find(" more since", begin) == std::string::npos) return 0;
  return std::stoul(line.substr(begin + 1));
}

TEST_F(EndpointsTest, ResultsThatAreIgnoredAreLoggedOnceASecond) {
  const auto publisher = agnocast::create_publisher<String>(node_.get(), "topic", 1);
  const auto other = agnocast::create_publisher<String>(node_.get(), "other", 1);
  const LogLines lines;
  const auto start = std::chrono::steady_clock::now();
  std::size_t failures = 0;
  for (; failures < 1000; ++failures) publisher->publish(other->borrow_loaned_message());
  std::this_thread::sleep_for(1100ms);
  publisher->publish(other->borrow_loaned_message());
  ++failures;
  publish(*other, "fine");
  const auto logged = lines.with("publishing on '/topic' failed: loan_invalid: ");
  ASSERT_GE(logged.size(), 2u) << "the first and the last";
  EXPECT_LE(logged.size(), seconds_begun_since(start));
  EXPECT_EQ(lines.with("'/topic' failed").size(), logged.size()) << "nothing else failed";
  EXPECT_THAT(lines.with("'/other' failed"), testing::IsEmpty());
  std::size_t told = 0;
  for (const std::string& line : logged) {
    EXPECT_THAT(line, testing::HasSubstr(agnocast::sentence_of(agnocast::Errc::loan_invalid)));
    EXPECT_THAT(line, testing::HasSubstr(agnocast::remedy_of(agnocast::Errc::loan_invalid)));
    told += 1 + silent_failures(line);
  }
  EXPECT_EQ(told, failures) << "each is in a line, or counted in the next one";
}

TEST_F(EndpointsTest, AFailedPublishEndsTheLoan) {
  const auto publisher = agnocast::create_publisher<String>(node_.get(), "topic", 1);
  const auto other = agnocast::create_publisher<String>(node_.get(), "other", 1);
  Message loan = other->borrow_loaned_message();
  publisher->publish(std::move(loan));
  EXPECT_FALSE(loan);  // NOLINT(bugprone-use-after-move)
}

TEST_F(EndpointsTest, WhatHasNoEffectIsLogged) {
  const LogLines lines;
  agnocast::PublisherOptions options;
  options.do_always_ros2_publish = true;
  const auto publisher = agnocast::create_publisher<String>(node_.get(), "topic",
                                                            rclcpp::QoS(1).deadline(1s), options);
  EXPECT_THAT(lines.with("do_always_ros2_publish has no effect"), testing::SizeIs(1));
  EXPECT_THAT(lines.with("deadline"), testing::IsEmpty());
}

TEST_F(EndpointsTest, NothingIsLoggedOfDefaults) {
  const LogLines lines;
  const auto subscription =
      agnocast::create_subscription<String>(node_.get(), "defaults", 1, [](const Message&) {});
  const auto sensor = agnocast::create_publisher<String>(node_.get(), "defaults",
                                                         rclcpp::SensorDataQoS().reliable());
  EXPECT_THAT(lines.with("defaults'"), testing::IsEmpty());
}

}  // namespace
}  // namespace agnocastlib
