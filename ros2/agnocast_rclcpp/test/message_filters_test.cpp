// SPDX-License-Identifier: Apache-2.0
//
// Goal: upstream's synchronizers give the same sets whether an input is rclcpp's or ours. Method:
// each message is published on both, with the same stamps; a synchronizer of two inputs of rclcpp's
// is the reference for those with one or two of ours.

#include "test_node.hpp"

#include <message_filters/subscriber.h>
#include <message_filters/sync_policies/approximate_time.h>
#include <message_filters/sync_policies/exact_time.h>
#include <message_filters/synchronizer.h>
#include <agnocast_rclcpp/message_filters.hpp>
#include <sensor_msgs/msg/temperature.hpp>

#include <random>
#include <vector>

namespace agnocast_rclcpp {
namespace {

using Temperature = sensor_msgs::msg::Temperature;
using Theirs = message_filters::Subscriber<Temperature>;
using Ours = agnocast::message_filters::Subscriber<Temperature>;
using Exact = message_filters::sync_policies::ExactTime<Temperature, Temperature>;
using Approximate = message_filters::sync_policies::ApproximateTime<Temperature, Temperature>;
using Pairs = std::vector<std::pair<double, double>>;

constexpr std::size_t depth = 50;

/// A synchronizer over two inputs, and what it gave.
template <class Policy, class First, class Second>
struct Synchronized {
  Synchronized(const rclcpp::Node::SharedPtr& node, const std::string& first,
               const std::string& second)
      : one(node, first, profile()),
        other(node, second, profile()),
        both(Policy(depth), one, other) {
    both.registerCallback(&Synchronized::note, this);
  }
  void note(const Temperature::ConstSharedPtr& a, const Temperature::ConstSharedPtr& b) {
    pairs.emplace_back(a->temperature, b->temperature);
  }
  static rmw_qos_profile_t profile() { return rclcpp::QoS(depth).get_rmw_qos_profile(); }

  Pairs pairs;
  First one;
  Second other;
  message_filters::Synchronizer<Policy> both;
};

template <class Policy>
class MessageFilters : public RclcppTest {};
using Policies = testing::Types<Exact, Approximate>;
TYPED_TEST_SUITE(MessageFilters, Policies);

TYPED_TEST(MessageFilters, MixedSourcesGiveTheSetsOfUpstream) {
  const auto node = std::make_shared<rclcpp::Node>("node");
  Synchronized<TypeParam, Theirs, Theirs> reference(node, "dds/a", "dds/b");
  Synchronized<TypeParam, Ours, Theirs> first(node, "shared/a", "dds/b");
  Synchronized<TypeParam, Theirs, Ours> second(node, "dds/a", "shared/b");
  Synchronized<TypeParam, Ours, Ours> ours(node, "shared/a", "shared/b");
  std::vector<rclcpp::Publisher<Temperature>::SharedPtr> dds;
  std::vector<agnocast::Publisher<Temperature>::SharedPtr> shared;
  for (const std::string topic : {"a", "b"}) {
    dds.push_back(node->create_publisher<Temperature>("dds/" + topic, depth));
    shared.push_back(agnocast::create_publisher<Temperature>(node, "shared/" + topic, depth));
  }
  rclcpp::executors::SingleThreadedExecutor executor;
  executor.add_node(node);
  const auto spin_for = [&](std::chrono::milliseconds time) {
    const auto end = std::chrono::steady_clock::now() + time;
    while (std::chrono::steady_clock::now() < end) executor.spin_once(std::chrono::milliseconds(1));
  };
  for (int i = 0; i < 3000; ++i) {
    if (dds[0]->get_subscription_count() == 2 && dds[1]->get_subscription_count() == 2 &&
        shared[0]->get_subscription_count() == 2 && shared[1]->get_subscription_count() == 2)
      break;
    executor.spin_once(std::chrono::milliseconds(10));
  }
  std::minstd_rand random(5);
  for (int second_of = 1; second_of <= 200; ++second_of) {
    for (const std::size_t topic : {0u, 1u}) {
      if (random() % 5 == 0) continue;  // left out on this topic
      Temperature message;
      message.header.stamp.sec = second_of;
      message.temperature = second_of + topic / 10.0;
      dds[topic]->publish(message);
      ASSERT_EQ(shared[topic]->publish(message).code, agnocast::Errc::ok);
      spin_for(std::chrono::milliseconds(2));
    }
  }
  spin_for(std::chrono::milliseconds(300));
  EXPECT_GT(reference.pairs.size(), 80u);
  EXPECT_EQ(first.pairs, reference.pairs);
  EXPECT_EQ(second.pairs, reference.pairs);
  EXPECT_EQ(ours.pairs, reference.pairs);
}

using FilterSource = RclcppTest;

TEST_F(FilterSource, MayEndAndBeginAgain) {
  const auto node = std::make_shared<rclcpp::Node>("node");
  Ours ours;
  ours.subscribe();
  EXPECT_EQ(ours.getTopic(), "");
  ours.subscribe(node, "topic", rclcpp::SensorDataQoS());
  EXPECT_EQ(ours.getTopic(), "topic");
  std::vector<double> heard;
  ours.registerCallback(std::function<void(const Temperature::ConstSharedPtr&)>(
      [&](const Temperature::ConstSharedPtr& message) { heard.push_back(message->temperature); }));
  const auto publisher = agnocast::create_publisher<Temperature>(node, "topic", 10);
  rclcpp::executors::SingleThreadedExecutor executor;
  executor.add_node(node);
  for (const double value : {1.0, 2.0, 3.0}) {
    const std::size_t before = heard.size();
    if (value == 2.0) {
      ours.unsubscribe();
      EXPECT_TRUE(eventually([&] { return publisher->get_subscription_count() == 0; }));
    } else {
      ours.subscribe();
      ASSERT_TRUE(eventually([&] { return publisher->get_subscription_count() == 1; }));
    }
    Temperature message;
    message.temperature = value;
    ASSERT_EQ(publisher->publish(message).code, agnocast::Errc::ok);
    for (int i = 0; i < (value == 2.0 ? 20 : 3000) && heard.size() == before; ++i)
      executor.spin_once(std::chrono::milliseconds(10));
  }
  EXPECT_EQ(heard, (std::vector<double>{1.0, 3.0}));
}

}  // namespace
}  // namespace agnocast_rclcpp
