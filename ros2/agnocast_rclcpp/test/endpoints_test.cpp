// SPDX-License-Identifier: Apache-2.0
//
// What an rclcpp node says when it creates an endpoint means here what it means there: QoS and its
// overrides, options, events, names of sub-nodes and lifecycle nodes, types of callbacks.

#include "test_node.hpp"

#include <agnocast/generic_service.hpp>
#include <rclcpp_lifecycle/lifecycle_node.hpp>
#include <std_srvs/srv/trigger.hpp>

#include <gmock/gmock.h>

#include <atomic>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <mutex>
#include <stdexcept>
#include <vector>

namespace agnocast_rclcpp {
namespace {

using namespace std::chrono_literals;
using Message = agnocast::ipc_shared_ptr<const String>;
using Trigger = std_srvs::srv::Trigger;

/// What is logged while it exists, from warnings on.
class Warnings {
 public:
  Warnings() : before_(rcutils_logging_get_output_handler()) {
    text().clear();
    rcutils_logging_set_output_handler([](const rcutils_log_location_t*, int severity, const char*,
                                          rcutils_time_point_value_t, const char* format,
                                          va_list* arguments) {
      char line[512];
      std::vsnprintf(line, sizeof line, format, *arguments);
      if (severity >= RCUTILS_LOG_SEVERITY_WARN) text() += line + std::string("\n");
    });
  }
  ~Warnings() { rcutils_logging_set_output_handler(before_); }
  const std::string& lines() const { return text(); }
  bool have(const char* words) const { return text().find(words) != std::string::npos; }

 private:
  static std::string& text() {
    static std::string all;
    return all;
  }
  const rcutils_logging_output_handler_t before_;
};

class EndpointsTest : public RclcppTest {
 protected:
  void SetUp() override {
    RclcppTest::SetUp();
    node_ = std::make_shared<rclcpp::Node>("node", "space");
    executor_ = std::make_unique<rclcpp::executors::SingleThreadedExecutor>();
    executor_->add_node(node_);
  }
  void TearDown() override {
    executor_.reset();
    node_.reset();
    RclcppTest::TearDown();
  }
  template <class Condition>
  [[nodiscard]] bool spin_until(Condition condition) {
    for (int i = 0; i < 3000 && !condition(); ++i) executor_->spin_once(10ms);
    return condition();
  }

  rclcpp::Node::SharedPtr node_;
  std::unique_ptr<rclcpp::executors::SingleThreadedExecutor> executor_;
};

TEST_F(EndpointsTest, ANodeMayKeepAsManyMessagesAsItsQueueIsLongAndIsWarnedAtMore) {
  const Warnings warnings;
  std::vector<std::shared_ptr<const String>> kept;
  const auto subscription = agnocast::create_subscription<String>(
      node_, "kept", 100,
      [&](std::shared_ptr<const String> message) { kept.push_back(std::move(message)); });
  const auto publisher = agnocast::create_publisher<String>(node_, "kept", 100);
  ASSERT_TRUE(spin_until([&] { return publisher->get_linked_subscription_count() == 1; }));
  for (int i = 0; i < 100; ++i) ASSERT_EQ(publisher->publish(String()).code, agnocast::Errc::ok);
  EXPECT_TRUE(spin_until([&] { return kept.size() == 100; })) << kept.size();
  EXPECT_EQ(warnings.lines(), "");
  ASSERT_EQ(publisher->publish(String()).code, agnocast::Errc::ok);
  EXPECT_TRUE(spin_until([&] { return warnings.have("'/space/kept' keeps as many messages"); }));
  kept.erase(kept.begin());
  EXPECT_TRUE(spin_until([&] { return kept.size() == 100; })) << kept.size();
}

TEST_F(EndpointsTest, QosIsReportedAndTakenMessagesAreAcknowledged) {
  const auto check = [&](const auto& publisher, const auto& subscription) {
    const rclcpp::QoS offered = publisher->get_actual_qos();
    EXPECT_EQ(offered.depth(), 7u);
    EXPECT_EQ(offered.history(), rclcpp::HistoryPolicy::KeepLast);
    EXPECT_EQ(offered.reliability(), rclcpp::ReliabilityPolicy::Reliable);
    EXPECT_EQ(offered.durability(), rclcpp::DurabilityPolicy::TransientLocal);
    const rclcpp::QoS requested = subscription->get_actual_qos();
    EXPECT_EQ(requested.reliability(), rclcpp::ReliabilityPolicy::BestEffort);
    EXPECT_EQ(requested.durability(), rclcpp::DurabilityPolicy::Volatile);
    EXPECT_TRUE(publisher->wait_for_all_acked(0s)) << "the only subscription is best effort";
    EXPECT_TRUE(publisher->wait_for_all_acked());
  };
  const rclcpp::QoS offer = rclcpp::QoS(7).transient_local();
  const auto ignore = [](const String&) {};
  check(node_->create_publisher<String>("of_ros", offer),
        node_->create_subscription<String>("of_ros", rclcpp::SensorDataQoS(), ignore));
  check(agnocast::create_publisher<String>(node_, "ours", offer),
        agnocast::create_subscription<String>(node_, "ours", rclcpp::SensorDataQoS(), ignore));

  const auto publisher = agnocast::create_publisher<String>(node_, "reliable", 10);
  const auto reliable = agnocast::create_subscription<String>(node_, "reliable", 10, ignore);
  ASSERT_TRUE(spin_until([&] { return publisher->get_linked_subscription_count() == 1; }));
  (void)publisher->publish(String());
  EXPECT_FALSE(publisher->wait_for_all_acked(10ms));
  EXPECT_TRUE(spin_until([&] { return publisher->wait_for_all_acked(0s); }));
}

TEST_F(EndpointsTest, OneSpinSomeCallsEachEndpointOnce) {
  // As rclcpp calls each of its subscriptions, in both types of groups.
  std::vector<int> heard(6, 0);
  rclcpp::SubscriptionOptions reentrant;
  reentrant.callback_group = node_->create_callback_group(rclcpp::CallbackGroupType::Reentrant);
  std::vector<agnocast::Subscription<String>::SharedPtr> subscriptions;
  for (std::size_t i = 0; i < heard.size(); ++i) {
    subscriptions.push_back(agnocast::create_subscription<String>(
        node_, "topic", 10, [&heard, i](const Message&) { ++heard[i]; },
        i < 3 ? rclcpp::SubscriptionOptions() : reentrant));
  }
  const auto publisher = agnocast::create_publisher<String>(node_, "topic", 10);
  ASSERT_TRUE(
      spin_until([&] { return publisher->get_linked_subscription_count() == heard.size(); }));
  executor_->spin_some();  // Jazzy's first one takes in what was created, and calls nothing
  for (int i = 0; i < 4; ++i) (void)publisher->publish(String());
  executor_->spin_some();
  EXPECT_THAT(heard, testing::Each(1));
  subscriptions[0].reset();  // the first of its group, and one in the middle
  subscriptions[4].reset();
  executor_->spin_some();
  EXPECT_THAT(heard, testing::ElementsAre(1, 2, 2, 2, 1, 2));
  executor_->spin_all(30s);
  EXPECT_THAT(heard, testing::ElementsAre(1, 4, 4, 4, 1, 4));
}

TEST_F(EndpointsTest, OneSpinSomeCallsNoEndpointTwice) {
  std::vector<int> heard(3, 0);
  std::vector<agnocast::Subscription<String>::SharedPtr> subscriptions;
  std::vector<agnocast::Publisher<String>::SharedPtr> publishers;
  for (std::size_t i = 0; i < heard.size(); ++i) {
    const std::string topic = "topic" + std::to_string(i);
    subscriptions.push_back(agnocast::create_subscription<String>(
        node_, topic, 10, [&heard, i](const Message&) { ++heard[i]; }));
    publishers.push_back(agnocast::create_publisher<String>(node_, topic, 10));
  }
  for (const auto& publisher : publishers)
    ASSERT_TRUE(spin_until([&] { return publisher->get_linked_subscription_count() == 1; }));
  const auto publish = [&](std::size_t i) { (void)publishers[i]->publish(String()); };
  executor_->spin_some();  // Jazzy's first one takes in what was created, and calls nothing
  for (const std::size_t i : {1, 2}) publish(i);
  executor_->spin_some();
  EXPECT_THAT(heard, testing::ElementsAre(0, 1, 1));
  for (const std::size_t i : {0, 0, 2}) publish(i);
  executor_->spin_some();
  EXPECT_THAT(heard, testing::ElementsAre(1, 1, 2));
  executor_->spin_some();
  EXPECT_THAT(heard, testing::ElementsAre(2, 1, 2));
}

TEST_F(EndpointsTest, CallbacksTakeTheMessageInEveryForm) {
  std::vector<std::string> heard;
  std::shared_ptr<const String> kept;
  std::vector<std::shared_ptr<void>> subscriptions;
  const auto add = [&](auto callback) {
    subscriptions.push_back(
        agnocast::create_subscription<String>(node_, "topic", 10, std::move(callback)));
  };
  add([&](const Message& message) { heard.push_back("pointer " + message->data); });
  add([&](const String& message) { heard.push_back("reference " + message.data); });
  add([&](std::shared_ptr<const String> message) {
    heard.push_back("shared " + message->data);
    kept = std::move(message);
  });
  add([&](String::ConstSharedPtr message, const agnocast::MessageInfo& info) {
    heard.push_back("shared with info " + message->data + std::to_string(info.sequence));
  });
  add([&](const String& message, const agnocast::MessageInfo& info) {
    heard.push_back("reference with info " + message.data + std::to_string(info.sequence));
  });
  rclcpp::MessageInfo of_ros;
  add([&](const Message& message, const rclcpp::MessageInfo& info) {
    heard.push_back("pointer with rclcpp's info " + message->data);
    of_ros = info;
  });
  const auto publisher = agnocast::create_publisher<String>(node_, "topic", 10);
  ASSERT_TRUE(spin_until([&] { return publisher->get_linked_subscription_count() == 6; }));
  const auto before = rclcpp::Clock(RCL_SYSTEM_TIME).now().nanoseconds();
  auto loan = publisher->borrow_loaned_message();
  loan->data = "1";
  ASSERT_EQ(publisher->publish(std::move(loan)).code, agnocast::Errc::ok);
  ASSERT_TRUE(spin_until([&] { return heard.size() == 6; }));
  EXPECT_THAT(heard, testing::UnorderedElementsAre("pointer 1", "reference 1", "shared 1",
                                                   "shared with info 11", "reference with info 11",
                                                   "pointer with rclcpp's info 1"));
  const rmw_message_info_t& info = of_ros.get_rmw_message_info();
  EXPECT_EQ(info.publication_sequence_number, 1u);
  EXPECT_LE(before, info.source_timestamp);
  EXPECT_LE(info.source_timestamp, info.received_timestamp);
  EXPECT_FALSE(info.from_intra_process);
  EXPECT_EQ(kept->data, "1") << "the message is held";
}

TEST_F(EndpointsTest, SubNodesAndLifecycleNodesHaveTheNamesOfRclcpp) {
  const auto sub_node = node_->create_sub_node("inner");
  const auto of_sub_node = agnocast::create_publisher<String>(sub_node, "topic", 10);
  EXPECT_STREQ(of_sub_node->get_topic_name(), "/space/inner/topic");
  EXPECT_STREQ(sub_node->create_publisher<String>("topic", 10)->get_topic_name(),
               "/space/inner/topic");
  const auto absolute = agnocast::create_publisher<String>(sub_node, "/topic", 10);
  EXPECT_STREQ(absolute->get_topic_name(), "/topic");
  const auto client = agnocast::create_client<Trigger>(sub_node, "service");
  EXPECT_STREQ(client->get_service_name(), "/space/inner/service");

  const auto lifecycle = std::make_shared<rclcpp_lifecycle::LifecycleNode>("lifecycle", "space");
  executor_->add_node(lifecycle->get_node_base_interface());
  int heard = 0;
  const auto subscription = agnocast::create_subscription<String>(lifecycle, "~/own", 10,
                                                                  [&](const Message&) { ++heard; });
  const auto publisher = agnocast::create_publisher<String>(lifecycle, "~/own", 10);
  EXPECT_STREQ(publisher->get_topic_name(), "/space/lifecycle/own");
  ASSERT_TRUE(spin_until([&] { return publisher->get_linked_subscription_count() == 1; }));
  (void)publisher->publish(String());
  EXPECT_TRUE(spin_until([&] { return heard == 1; }));
}

TEST_F(EndpointsTest, QosIsOverriddenByParameters) {
  const auto node = std::make_shared<rclcpp::Node>(
      "overridden", rclcpp::NodeOptions().parameter_overrides(
                        {{"qos_overrides./latched.publisher.durability", "transient_local"},
                         {"qos_overrides./latched.publisher.depth", 3}}));
  rclcpp::PublisherOptions options;
  options.qos_overriding_options = rclcpp::QosOverridingOptions::with_default_policies();
  const auto without = agnocast::create_publisher<String>(node, "plain", 10, options);
  options.qos_overriding_options =
      rclcpp::QosOverridingOptions{rclcpp::QosPolicyKind::Durability, rclcpp::QosPolicyKind::Depth};
  const auto latched = agnocast::create_publisher<String>(node, "latched", 10, options);
  EXPECT_TRUE(node->has_parameter("qos_overrides./plain.publisher.reliability"));
  for (const char* text : {"1", "2", "3", "4"}) {
    String message;
    message.data = text;
    ASSERT_EQ(latched->publish(message).code, agnocast::Errc::ok);
  }
  std::string late;
  const auto subscription =
      agnocast::create_subscription<String>(node_, "/latched", rclcpp::QoS(10).transient_local(),
                                            [&](const String& message) { late += message.data; });
  EXPECT_TRUE(spin_until([&] { return late == "234"; })) << late;
}

TEST_F(EndpointsTest, QosOfSubscriptionsIsOverriddenByParametersToo) {
  const auto node = std::make_shared<rclcpp::Node>(
      "overridden", rclcpp::NodeOptions().parameter_overrides(
                        {{"qos_overrides./sensor.subscription_front.reliability", "best_effort"},
                         {"qos_overrides./sensor.subscription_front.depth", 3},
                         {"qos_overrides./wrong.subscription.reliability", "perhaps"},
                         {"qos_overrides./refused.subscription.depth", 100}}));
  const auto ignore = [](const Message&) {};
  rclcpp::SubscriptionOptions options;
  options.qos_overriding_options = rclcpp::QosOverridingOptions(
      {rclcpp::QosPolicyKind::Reliability, rclcpp::QosPolicyKind::Depth}, nullptr, "front");
  const auto subscription =
      agnocast::create_subscription<String>(node, "sensor", 10, ignore, options);
  const rclcpp::QoS actual = subscription->get_actual_qos();
  EXPECT_EQ(actual.reliability(), rclcpp::ReliabilityPolicy::BestEffort);
  EXPECT_EQ(actual.depth(), 3u);

  // The exceptions are those of rclcpp's own endpoint.
  const auto exception_of = [&](const char* topic, const auto& create) -> std::string {
    try {
      create(topic);
    } catch (const rclcpp::exceptions::InvalidQosOverridesException& error) {
      return std::string("overrides: ") + error.what();
    } catch (const std::exception& error) {
      return error.what();
    }
    return "none";
  };
  const auto of_ours = [&](const char* topic) {
    agnocast::create_subscription<String>(node, topic, 10, ignore, options);
  };
  const auto of_ros = [&](const char* topic) {
    node->create_subscription<String>(
        topic, 10, [](const String&) {}, options);
  };
  options.qos_overriding_options =
      rclcpp::QosOverridingOptions({rclcpp::QosPolicyKind::Reliability});
  const std::string wrong = exception_of("wrong", of_ours);
  EXPECT_NE(wrong, "none");
  EXPECT_EQ(wrong, exception_of("wrong", of_ros));
  options.qos_overriding_options =
      rclcpp::QosOverridingOptions({rclcpp::QosPolicyKind::Depth}, [](const rclcpp::QoS& qos) {
        rclcpp::QosCallbackResult result;
        result.successful = qos.depth() < 50;
        result.reason = "too deep";
        return result;
      });
  EXPECT_THAT(exception_of("refused", of_ours), testing::StartsWith("overrides: "));
  EXPECT_EQ(exception_of("refused", of_ours), exception_of("refused", of_ros));
}

TEST_F(EndpointsTest, IncompatibleQosIsToldAsRclcppTellsIt) {
  const Warnings warnings;
  int reported = 0;
  rclcpp::QOSRequestedIncompatibleQoSInfo last{};
  rclcpp::SubscriptionOptions options;
  options.event_callbacks.incompatible_qos_callback =
      [&](rclcpp::QOSRequestedIncompatibleQoSInfo& info) {
        ++reported;
        last = info;
      };
  const auto wanting = agnocast::create_subscription<String>(
      node_, "topic", rclcpp::QoS(10).reliable(), [](const Message&) {}, options);
  const auto warning = agnocast::create_subscription<String>(
      node_, "topic", rclcpp::QoS(10).reliable(), [](const Message&) {});
  const auto publisher =
      agnocast::create_publisher<String>(node_, "topic", rclcpp::QoS(10).best_effort());
  EXPECT_TRUE(spin_until([&] {
    return reported == 1 && warnings.have("New publisher discovered on topic '/space/topic'") &&
           warnings.have("New subscription discovered on topic '/space/topic'");
  }));
  EXPECT_EQ(last.last_policy_kind, RMW_QOS_POLICY_RELIABILITY);
  EXPECT_EQ(last.total_count, 1);
}

TEST_F(EndpointsTest, WhatHasNoEffectIsToldWhereverItIsEnabled) {
  const auto measured = std::make_shared<rclcpp::Node>(
      "measured", rclcpp::NodeOptions().enable_topic_statistics(true));
  const Warnings warnings;
  rclcpp::SubscriptionOptions options;
  (void)agnocast::create_subscription<String>(
      node_, "quiet", 10, [](const Message&) {}, options);
  (void)agnocast::create_subscription<String>(
      measured, "node", 10, [](const Message&) {}, options);
  options.topic_stats_options.state = rclcpp::TopicStatisticsState::Disable;
  (void)agnocast::create_subscription<String>(
      measured, "off", 10, [](const Message&) {}, options);
  options.topic_stats_options.state = rclcpp::TopicStatisticsState::Enable;
  (void)agnocast::create_subscription<String>(
      node_, "on", 10, [](const Message&) {}, options);
  EXPECT_EQ(warnings.lines(),
            "collecting topic statistics has no effect on '/node', which agnocast serves\n"
            "collecting topic statistics has no effect on '/space/on', which agnocast serves\n");
}

TEST_F(EndpointsTest, NoQosIsWithoutEffect) {
  const Warnings warnings;
  using namespace std::chrono_literals;
  const rclcpp::QoS all = rclcpp::QoS(1)
                              .deadline(1h)
                              .lifespan(1h)
                              .liveliness(rclcpp::LivelinessPolicy::ManualByTopic)
                              .liveliness_lease_duration(1h);
  const auto publisher = agnocast::create_publisher<String>(node_, "topic", all);
  const rclcpp::QoS actual = publisher->get_actual_qos();
  EXPECT_EQ(actual, all);
  EXPECT_EQ(warnings.lines(), "");
}

TEST_F(EndpointsTest, LivelinessIsToldAsRclcppTellsIt) {
  using namespace std::chrono_literals;
  int lost = 0, alive = 0, not_alive = 0;
  rclcpp::PublisherOptions of_publisher;
  of_publisher.event_callbacks.liveliness_callback = [&](rclcpp::QOSLivelinessLostInfo& info) {
    lost = info.total_count;
  };
  rclcpp::SubscriptionOptions of_subscription;
  of_subscription.event_callbacks.liveliness_callback =
      [&](rclcpp::QOSLivelinessChangedInfo& info) {
        alive = info.alive_count;
        not_alive = info.not_alive_count;
      };
  const rclcpp::QoS qos = rclcpp::QoS(1)
                              .liveliness(rclcpp::LivelinessPolicy::ManualByTopic)
                              .liveliness_lease_duration(10ms);
  auto publisher = agnocast::create_publisher<String>(node_, "topic", qos, of_publisher);
  const auto subscription = agnocast::create_subscription<String>(
      node_, "topic", qos, [](const Message&) {}, of_subscription);
  EXPECT_TRUE(spin_until([&] { return lost >= 1 && not_alive == 1 && alive == 0; }));
  publisher.reset();
  EXPECT_TRUE(spin_until([&] { return not_alive == 0 && alive == 0; }));
}

TEST_F(EndpointsTest, MissedDeadlinesAreToldAsRclcppTellsThem) {
  using namespace std::chrono_literals;
  int offered = 0, requested = 0;
  rclcpp::PublisherOptions of_publisher;
  of_publisher.event_callbacks.deadline_callback = [&](rclcpp::QOSDeadlineOfferedInfo& info) {
    offered += info.total_count_change;
  };
  rclcpp::SubscriptionOptions of_subscription;
  of_subscription.event_callbacks.deadline_callback = [&](rclcpp::QOSDeadlineRequestedInfo& info) {
    requested += info.total_count_change;
  };
  const rclcpp::QoS qos = rclcpp::QoS(1).deadline(10ms);
  const auto publisher = agnocast::create_publisher<String>(node_, "topic", qos, of_publisher);
  int received = 0;
  const auto subscription = agnocast::create_subscription<String>(
      node_, "topic", qos, [&](const Message&) { ++received; }, of_subscription);
  EXPECT_TRUE(spin_until([&] { return publisher->get_linked_subscription_count() == 1; }));
  EXPECT_EQ(offered, 0) << "the first period begins with the first message";
  publisher->publish(publisher->borrow_loaned_message());
  EXPECT_TRUE(spin_until([&] { return received == 1 && offered >= 2 && requested >= 2; }));
}

TEST_F(EndpointsTest, GroupsOfOthersAreRefused) {
  const auto other = std::make_shared<rclcpp::Node>("other");
  rclcpp::SubscriptionOptions options;
  options.callback_group =
      other->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
  EXPECT_THROW(agnocast::create_subscription<String>(
                   node_, "topic", 10, [](const Message&) {}, options),
               std::exception);
}

TEST_F(EndpointsTest, ServicesAndClientsRunInTheNodesGroups) {
  const auto group = node_->create_callback_group(rclcpp::CallbackGroupType::Reentrant);
  const auto service = agnocast::create_service<Trigger>(
      node_, "service",
      [](const agnocast::ipc_shared_ptr<const Trigger::Request>&,
         agnocast::ipc_shared_ptr<Trigger::Response>& response) { response->message = "done"; },
      rclcpp::ServicesQoS(), group);
  const auto client = agnocast::create_client<Trigger>(node_, "service");
  ASSERT_TRUE(client->wait_for_service(30s));
  std::string answer;
  (void)client->async_send_request(client->borrow_loaned_request(),
                                   [&](auto future) { answer = future.get()->message; });
  EXPECT_TRUE(spin_until([&] { return answer == "done"; }));
}

TEST_F(EndpointsTest, WaitingForAServiceEndsWithRclcpp) {
  const auto client =
      agnocast::create_client<Trigger>(node_, "nobody", rmw_qos_profile_services_default);
  EXPECT_FALSE(client->wait_for_service(10ms));
  std::thread ending([] {
    std::this_thread::sleep_for(50ms);
    (void)rclcpp::shutdown();
  });
  EXPECT_FALSE(client->wait_for_service());
  ending.join();
}

TEST_F(EndpointsTest, ANodeIsInTheDomainOfItsContext) {
  const auto context = std::make_shared<rclcpp::Context>();
  rclcpp::InitOptions options;
  options.set_domain_id(*agnocast::domain_id() + 1);
  context->init(0, nullptr, options);
  const auto other =
      std::make_shared<rclcpp::Node>("other", rclcpp::NodeOptions().context(context));
  const auto far = agnocast::create_publisher<String>(other, "topic", 10);
  const auto near = agnocast::create_publisher<String>(node_, "topic", 10);
  std::atomic<int> count{0};
  const auto subscription =
      agnocast::create_subscription<String>(node_, "topic", 10, [&](const Message&) { ++count; });
  EXPECT_TRUE(spin_until([&] { return near->get_linked_subscription_count() == 1; }));
  EXPECT_EQ(far->get_subscription_count(), 0u);
  EXPECT_TRUE(far->publish(far->borrow_loaned_message()));
  EXPECT_TRUE(near->publish(near->borrow_loaned_message()));
  EXPECT_TRUE(spin_until([&] { return count == 1; }));
  const auto client = agnocast::create_client<Trigger>(other, "service");
  EXPECT_FALSE(client->service_is_ready());
  context->shutdown("the test ends");
  // Its environment does not move a process.
  const char* const before = std::getenv("ROS_DOMAIN_ID");
  const std::string domain = before != nullptr ? before : "0";
  ::setenv("ROS_DOMAIN_ID", std::to_string(*agnocast::domain_id() + 1).c_str(), 1);
  EXPECT_TRUE(agnocast::try_create_publisher<String>(node_, "topic", 10));
  ::setenv("ROS_DOMAIN_ID", domain.c_str(), 1);
}

TEST_F(EndpointsTest, NothingIsCreatedAfterShutdown) {
  const auto before = agnocast::create_publisher<String>(node_, "before", 10);
  (void)rclcpp::shutdown();
  EXPECT_THROW(agnocast::create_publisher<String>(node_, "topic", 10),
               rclcpp::exceptions::RCLErrorBase);
  EXPECT_THROW(agnocast::create_client<Trigger>(node_, "service"),
               rclcpp::exceptions::RCLErrorBase);
}

TEST_F(EndpointsTest, GenericPublishersServicesAndClientsFindTypesByName) {
  std::string heard;
  const auto subscription = agnocast::create_subscription<String>(
      node_, "topic", 10, [&](const String& message) { heard = message.data; });
  const auto publisher =
      agnocast::create_generic_publisher(node_, "topic", "std_msgs/msg/String", rclcpp::QoS(10));
  ASSERT_TRUE(spin_until([&] { return publisher->get_linked_subscription_count() == 1; }));
  agnocast::GenericLoan loan = publisher->borrow_loaned_message();
  static_cast<String*>(loan.get())->data = "words";
  EXPECT_EQ(publisher->publish(std::move(loan)).code, agnocast::Errc::ok);
  EXPECT_TRUE(spin_until([&] { return heard == "words"; }));

  const auto group = node_->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
  const auto service = agnocast::create_generic_service(
      node_, "service", "std_srvs/srv/Trigger",
      [](agnocast::GenericMessage, agnocast::GenericLoan& response) {
        static_cast<Trigger::Response*>(response.get())->message = "done";
      },
      rclcpp::ServicesQoS(), group);
  const auto client = agnocast::create_generic_client(node_, "service", "std_srvs/srv/Trigger");
  ASSERT_TRUE(client->wait_for_service(30s));
  std::string answer;
  (void)client->async_send_request(client->borrow_loaned_request(), [&](auto future) {
    answer = static_cast<const Trigger::Response*>(future.get().get())->message;
  });
  EXPECT_TRUE(spin_until([&] { return answer == "done"; }));
}

TEST_F(EndpointsTest, GenericSubscriptionsFindTypesByName) {
  std::string heard;
  const auto subscription = agnocast::create_generic_subscription(
      node_, "topic", "std_msgs/msg/String", rclcpp::QoS(10),
      [&](agnocast::GenericMessage message) {
        heard = static_cast<const String*>(message.get())->data;
      });
  const auto publisher = agnocast::create_publisher<String>(node_, "topic", 10);
  ASSERT_TRUE(spin_until([&] { return publisher->get_linked_subscription_count() == 1; }));
  String message;
  message.data = "words";
  (void)publisher->publish(message);
  EXPECT_TRUE(spin_until([&] { return !heard.empty(); }));
}

TEST_F(EndpointsTest, OptionsOfAgnocastAreTakenAsWell) {
  int heard = 0;
  const auto subscription = agnocast::create_subscription<String>(
      node_, "topic", 10, [&](const Message&) { ++heard; },
      agnocast::SubscriptionOptions().hold_quota(3).depth_per_publisher());
  const auto publisher = agnocast::create_publisher<String>(node_, "topic", 10);
  ASSERT_TRUE(spin_until([&] { return publisher->get_linked_subscription_count() == 1; }));
  (void)publisher->publish(String());
  EXPECT_TRUE(spin_until([&] { return heard == 1; }));
}

TEST_F(EndpointsTest, PublicationsOfTheProcessAreIgnoredOnRequest) {
  rclcpp::SubscriptionOptions options;
  options.ignore_local_publications = true;
  int heard = 0, ignored = 0;
  const auto hears =
      agnocast::create_subscription<String>(node_, "topic", 10, [&](const Message&) { ++heard; });
  const auto ignores = agnocast::create_subscription<String>(
      node_, "topic", 10, [&](const Message&) { ++ignored; }, options);
  const auto publisher = agnocast::create_publisher<String>(node_, "topic", 10);
  ASSERT_TRUE(spin_until([&] { return publisher->get_linked_subscription_count() == 1; }));
  (void)publisher->publish(String());
  EXPECT_TRUE(spin_until([&] { return heard == 1; }));
  EXPECT_EQ(ignored, 0);
  EXPECT_EQ(ignores->get_publisher_count(), 0u);
}

TEST_F(EndpointsTest, PollingSubscriptionsNeedNoSpin) {
  const auto subscription = agnocast::create_subscription<String>(node_, "topic", rclcpp::QoS(1));
  const auto publisher = agnocast::create_publisher<String>(node_, "topic", 10);
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  (void)publisher->publish(String());
  EXPECT_TRUE(eventually([&] { return subscription->take_data() != nullptr; }));
}

}  // namespace
}  // namespace agnocast_rclcpp
