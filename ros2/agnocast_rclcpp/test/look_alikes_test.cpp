// SPDX-License-Identifier: Apache-2.0
//
// Goal: what the tests without ROS 2 show with classes that look like rclcpp's is true of rclcpp's
// own. Method: the cases of tests/integration/client/api/api_test.cpp that have such a class, with
// the real one.

#include "test_node.hpp"

#include <std_srvs/srv/trigger.hpp>

#include <gmock/gmock.h>

#include <chrono>
#include <memory>
#include <string>

namespace agnocast_rclcpp {
namespace {

using namespace std::chrono_literals;
using Trigger = std_srvs::srv::Trigger;
using Message = agnocast::ipc_shared_ptr<const String>;

class LookAlikesTest : public RclcppTest {
 protected:
  void SetUp() override {
    RclcppTest::SetUp();
    node_ = std::make_shared<rclcpp::Node>("node", "ns");
  }
  void TearDown() override {
    node_.reset();
    RclcppTest::TearDown();
  }
  rclcpp::Node::SharedPtr node_;
};

TEST_F(LookAlikesTest, NamesAreRemappedByTheNodesArguments) {
  const auto remapped = std::make_shared<rclcpp::Node>(
      "node", "ns",
      rclcpp::NodeOptions().arguments({"--ros-args", "-r", "points:=/remapped/points", "-r",
                                       "ask:=answer", "-r", "__ns:=/other"}));
  const auto publisher = agnocast::create_publisher<String>(remapped, "points", 10);
  EXPECT_STREQ(publisher->get_topic_name(), "/remapped/points");
  EXPECT_STREQ(publisher->get_topic_name(),
               remapped->create_publisher<String>("points", 10)->get_topic_name());
  const auto subscription =
      agnocast::create_subscription<String>(remapped, "plain", 10, [](const Message&) {});
  EXPECT_STREQ(subscription->get_topic_name(), "/other/plain");
  const auto service =
      agnocast::create_service<Trigger>(remapped, "ask",
                                        [](const agnocast::ipc_shared_ptr<const Trigger::Request>&,
                                           agnocast::ipc_shared_ptr<Trigger::Response>&) {});
  EXPECT_STREQ(service->get_service_name(), "/other/answer");
  const auto client = agnocast::create_client<Trigger>(remapped, "ask");
  EXPECT_TRUE(client->wait_for_service(30s));
  const auto elsewhere =
      agnocast::create_subscription<String>(node_, "/remapped/points", rclcpp::QoS(10));
  EXPECT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
}

TEST_F(LookAlikesTest, AHistoryWithoutADepthHasDepthOne) {
  const rclcpp::QoS all{rclcpp::KeepAll()};
  EXPECT_TRUE(agnocast::QoS(all).is_keep_all());
  EXPECT_EQ(agnocast::QoS(all).depth(), agnocast::QoS(1).keep_all().depth());
  EXPECT_TRUE(agnocast::try_create_subscription<String>(node_, "all", all));
  const rclcpp::QoS defaults = rclcpp::SystemDefaultsQoS();
  EXPECT_FALSE(agnocast::QoS(defaults).is_keep_all());
  EXPECT_EQ(agnocast::QoS(defaults).depth(), 1u);
  EXPECT_TRUE(agnocast::try_create_publisher<String>(node_, "defaults", defaults));
  const auto refused = agnocast::try_create_subscription<String>(node_, "last", agnocast::QoS(0));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, agnocast::Errc::depth_refused);
}

TEST_F(LookAlikesTest, ProfilesOfRmwConvert) {
  const agnocast::QoS sensor = rmw_qos_profile_sensor_data;
  EXPECT_EQ(sensor.depth(), 5u);
  EXPECT_FALSE(sensor.is_keep_all());
  EXPECT_FALSE(sensor.is_reliable());
  EXPECT_FALSE(sensor.is_transient_local());
  EXPECT_EQ(sensor.deadline(), 0ns);
  EXPECT_EQ(sensor.lifespan(), 0ns);
  EXPECT_EQ(sensor.liveliness_lease_duration(), 0ns);
  EXPECT_EQ(sensor.liveliness(), agnocast::Liveliness::automatic);
  rmw_qos_profile_t all = rmw_qos_profile_default;
  all.history = RMW_QOS_POLICY_HISTORY_KEEP_ALL;
  all.durability = RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL;
  all.deadline = {1, 5};
  all.lifespan = RMW_DURATION_INFINITE;
  all.liveliness = RMW_QOS_POLICY_LIVELINESS_MANUAL_BY_TOPIC;
  all.liveliness_lease_duration = {0, 1'500'000'000};
  const agnocast::QoS qos = all;
  EXPECT_TRUE(qos.is_keep_all());
  EXPECT_TRUE(qos.is_reliable());
  EXPECT_TRUE(qos.is_transient_local());
  EXPECT_EQ(qos.deadline(), 1s + 5ns);
  EXPECT_EQ(qos.lifespan(), 0ns);
  EXPECT_EQ(qos.liveliness(), agnocast::Liveliness::manual_by_topic);
  EXPECT_EQ(qos.liveliness_lease_duration(), 1500ms);
  EXPECT_TRUE(
      agnocast::try_create_publisher<String>(node_, "profile", rmw_qos_profile_sensor_data));
}

TEST_F(LookAlikesTest, TimesOfAQosConvertBothWays) {
  const rclcpp::QoS told = rclcpp::QoS(1)
                               .deadline(1ms)
                               .lifespan(2s)
                               .liveliness(rclcpp::LivelinessPolicy::ManualByTopic)
                               .liveliness_lease_duration(3h);
  const agnocast::QoS all = told;
  EXPECT_EQ(all.deadline(), 1ms);
  EXPECT_EQ(all.lifespan(), 2s);
  EXPECT_EQ(all.liveliness_lease_duration(), 3h);
  EXPECT_EQ(all.liveliness(), agnocast::Liveliness::manual_by_topic);
  const rclcpp::QoS back =
      agnocast::create_publisher<String>(node_, "timed", told)->get_actual_qos();
  EXPECT_EQ(back, told);
  const agnocast::QoS none = rclcpp::QoS(1);
  EXPECT_EQ(none.deadline(), 0ns) << "infinite";
  const rclcpp::QoS infinite = none;
  EXPECT_EQ(infinite.deadline(), rclcpp::QoS(1).deadline());
}

TEST_F(LookAlikesTest, AnExceptionOfANodeAboutANameIsAnOrdinaryFailure) {
  const auto publisher = agnocast::try_create_publisher<String>(node_, "a b", 10);
  ASSERT_FALSE(publisher);
  EXPECT_EQ(publisher.error().code, agnocast::Errc::invalid_name);
  EXPECT_THAT(text_of(publisher.error()), testing::HasSubstr("a b"));
  const auto subscription =
      agnocast::try_create_subscription<String>(node_, "a b", rclcpp::QoS(10));
  ASSERT_FALSE(subscription);
  EXPECT_EQ(subscription.error().code, agnocast::Errc::invalid_name);
}

}  // namespace
}  // namespace agnocast_rclcpp
