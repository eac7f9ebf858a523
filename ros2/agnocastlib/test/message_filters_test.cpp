// SPDX-License-Identifier: Apache-2.0
//
// Goal: synchronizers give the sets of upstream's, in every form of callback. Method: messages of
// one stamp are published on topics of both kinds; a synchronizer of upstream's over rclcpp's
// subscriptions is the reference.

#include "common.hpp"

#include <message_filters/subscriber.h>
#include <agnocast/message_filters/pass_through.hpp>
#include <agnocast/message_filters/subscriber.hpp>
#include <agnocast/message_filters/sync_policies/approximate_time.hpp>
#include <agnocast/message_filters/sync_policies/exact_time.hpp>
#include <agnocast/message_filters/synchronizer.hpp>
#include <sensor_msgs/msg/temperature.hpp>

#include <functional>
#include <random>

namespace agnocastlib {
namespace {

namespace filters = agnocast::message_filters;
using Temperature = sensor_msgs::msg::Temperature;
using Pointer = agnocast::ipc_shared_ptr<const Temperature>;
using Event = filters::MessageEvent<const Temperature>;
using Exact = filters::sync_policies::ExactTime<Temperature, Temperature>;
using Approximate = filters::sync_policies::ApproximateTime<Temperature, Temperature>;
using Pairs = std::vector<std::pair<double, double>>;

constexpr std::size_t depth = 50;
rmw_qos_profile_t profile() { return rclcpp::QoS(depth).get_rmw_qos_profile(); }

Temperature temperature_at(int milliseconds) {
  Temperature message;
  message.header.stamp.sec = milliseconds / 1000;
  message.header.stamp.nanosec = static_cast<unsigned>(milliseconds % 1000) * 1'000'000;
  message.temperature = milliseconds;
  return message;
}

class MessageFiltersTest : public NodeTest {
 protected:
  /// Publishes a message when something listens.
  void send(agnocast::Publisher<Temperature>& publisher, int milliseconds) {
    auto message = publisher.borrow_loaned_message();
    *message = temperature_at(milliseconds);
    publisher.publish(std::move(message));
  }
};

template <class Policy>
class Policies : public MessageFiltersTest {};
using BothPolicies = testing::Types<Exact, Approximate>;
TYPED_TEST_SUITE(Policies, BothPolicies);

/// A class as people write it.
template <class Policy>
struct Pairing {
  Pairs pairs;
  void callback(const Pointer& a, const Pointer& b) {
    pairs.emplace_back(a->temperature, b->temperature);
  }
  void events(const Event& a, const Event& b) {
    EXPECT_GT(a.getReceiptTime().nanoseconds(), 0);
    pairs.emplace_back(a.getMessage()->temperature, b.getConstMessage()->temperature);
  }
};

TYPED_TEST(Policies, GiveTheSetsOfUpstream) {
  using Upstream = ::message_filters::Subscriber<Temperature>;
  using Ours = filters::Subscriber<Temperature>;
  Upstream dds_a(this->node_, "dds/a", profile()), dds_b(this->node_, "dds/b", profile());
  ::message_filters::Synchronizer<typename TypeParam::Upstream> reference(
      typename TypeParam::Upstream(depth), dds_a, dds_b);
  Pairs expected;
  struct Reference {
    Pairs& pairs;
    void callback(const Temperature::ConstSharedPtr& a, const Temperature::ConstSharedPtr& b) {
      pairs.emplace_back(a->temperature, b->temperature);
    }
  } noting{expected};
  reference.registerCallback(&Reference::callback, &noting);
  Ours a(this->node_, "shared/a", profile()), b(this->node_.get(), "shared/b", profile());
  filters::Synchronizer<TypeParam> sync(TypeParam(depth), a, b);
  Pairing<TypeParam> by_bind, by_member, by_events;
  Pairs by_lambda;
  sync.registerCallback(std::bind(&Pairing<TypeParam>::callback, &by_bind, std::placeholders::_1,
                                  std::placeholders::_2));
  sync.registerCallback(&Pairing<TypeParam>::callback, &by_member);
  sync.registerCallback(&Pairing<TypeParam>::events, &by_events);
  sync.registerCallback([&](const Pointer& first, Pointer second) {
    by_lambda.emplace_back(first->temperature, second->temperature);
  });

  const auto to_dds_a = this->node_->template create_publisher<Temperature>("dds/a", depth);
  const auto to_dds_b = this->node_->template create_publisher<Temperature>("dds/b", depth);
  const auto to_a = agnocast::create_publisher<Temperature>(this->node_.get(), "shared/a", depth);
  const auto to_b = agnocast::create_publisher<Temperature>(this->node_.get(), "shared/b", depth);
  ASSERT_TRUE(this->spin_until([&] {
    return to_dds_a->get_subscription_count() == 1 && to_dds_b->get_subscription_count() == 1 &&
           to_a->get_linked_subscription_count() == 1 && to_b->get_linked_subscription_count() == 1;
  }));
  std::mt19937 random(1);
  for (int i = 0; i < 40; ++i) {
    const int at = 100 * i;
    const int other = at + static_cast<int>(random() % 3) * 20;  // sometimes the same
    if (random() % 5 != 0) {
      to_dds_a->publish(temperature_at(at));
      this->send(*to_a, at);
    }
    to_dds_b->publish(temperature_at(other));
    this->send(*to_b, other);
    for (int spins = 0; spins < 20; ++spins) this->executor_->spin_once(1ms);
  }
  EXPECT_TRUE(
      this->spin_until([&] { return by_lambda.size() == expected.size() && !expected.empty(); }));
  EXPECT_EQ(by_lambda, expected);
  EXPECT_EQ(by_bind.pairs, expected);
  EXPECT_EQ(by_member.pairs, expected);
  EXPECT_EQ(by_events.pairs, expected);
}

TEST_F(MessageFiltersTest, ExactTimeTellsOfSetsThatAreDropped) {
  filters::PassThrough<Temperature> a, b;
  filters::Synchronizer<Exact> sync(Exact(10));
  sync.connectInput(a, b);
  Pairs complete;
  std::vector<bool> has_second;
  sync.registerCallback([&](const Pointer& first, const Pointer& second) {
    complete.emplace_back(first->temperature, second->temperature);
  });
  sync.registerDropCallback([&](const Pointer& first, const Pointer& second) {
    EXPECT_TRUE(first);
    has_second.push_back(bool(second));
  });
  const auto subscription = std::make_shared<agnocast::TakeSubscription<Temperature>>(
      node_.get(), "topic", rclcpp::QoS(depth));
  const auto publisher = agnocast::create_publisher<Temperature>(node_.get(), "topic", depth);
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  send(*publisher, 1);
  send(*publisher, 2);
  const Pointer one = subscription->take(), two = subscription->take();
  a.add(one);
  a.add(two);
  b.add(two);
  EXPECT_EQ(complete, Pairs({{2, 2}}));
  EXPECT_EQ(has_second, std::vector<bool>{false});
  sync.add<0>(one);
  sync.add<1>(one);
  EXPECT_EQ(complete.size(), 2u);
}

TEST_F(MessageFiltersTest, FiltersHoldMessagesAndPassThemOn) {
  filters::Subscriber<Temperature> source;
  source.subscribe(node_, "topic", profile());
  EXPECT_EQ(source.getTopic(), "topic");
  filters::PassThrough<Temperature> pass(source);
  Pointer kept;
  std::vector<double> events;
  pass.registerCallback([&](const Pointer& message) { kept = message; });
  pass.registerCallback(
      [&](const Event& event) { events.push_back(event.getMessage()->temperature); });
  const auto publisher = agnocast::create_publisher<Temperature>(node_.get(), "topic", depth);
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  send(*publisher, 7);
  ASSERT_TRUE(spin_until([&] { return !events.empty(); }));
  source.unsubscribe();
  EXPECT_EQ(source.getSubscriber(), nullptr);
  EXPECT_EQ(kept->temperature, 7) << "the message is held";
  source.subscribe();
  // The former one, which holds a message, leaves a moment later.
  ASSERT_TRUE(eventually([&] { return publisher->get_intra_subscription_count() == 1; }));
  send(*publisher, 8);
  EXPECT_TRUE(spin_until([&] { return events.size() == 2; }));
  EXPECT_EQ(events, (std::vector<double>{7, 8}));
}

TEST_F(MessageFiltersTest, AFilterMayHold256Messages) {
  filters::Subscriber<Temperature> source(node_, "topic", profile());
  std::vector<Pointer> kept;
  source.registerCallback([&](const Pointer& message) { kept.push_back(message); });
  const auto publisher = agnocast::create_publisher<Temperature>(node_.get(), "topic", depth);
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  for (int i = 0; i < 256; ++i) {
    send(*publisher, i);
    ASSERT_TRUE(spin_until([&] { return kept.size() == static_cast<std::size_t>(i) + 1; }));
  }
  send(*publisher, 256);
  for (int i = 0; i < 20; ++i) executor_->spin_once(1ms);
  EXPECT_EQ(kept.size(), 256u) << "further messages stay unread";
  kept.pop_back();
  EXPECT_TRUE(spin_until([&] { return kept.size() == 256; })) << "until one is released";
}

TEST_F(MessageFiltersTest, NodesOfAgnocastAreTaken) {
  const auto node = std::make_shared<agnocast::Node>("ours");
  executor_->add_node(node);
  filters::Subscriber<Temperature, agnocast::Node> a(node, "a", profile());
  filters::Subscriber<Temperature, agnocast::Node> b(node.get(), "b", profile(), {});
  filters::Synchronizer<Approximate> sync(Approximate(10), a, b);
  sync.setAgePenalty(0.5);
  sync.setMaxIntervalDuration(rclcpp::Duration(1s));
  int count = 0;
  sync.registerCallback([&](const Pointer&, const Pointer&) { ++count; });
  const auto to_a = node->create_publisher<Temperature>("a", depth);
  const auto to_b = node->create_publisher<Temperature>("b", depth);
  ASSERT_TRUE(spin_until([&] {
    return to_a->get_linked_subscription_count() == 1 && to_b->get_linked_subscription_count() == 1;
  }));
  for (int i = 0; i < 5; ++i) {
    send(*to_a, 100 * i);
    send(*to_b, 100 * i + 1);
  }
  EXPECT_TRUE(spin_until([&] { return count >= 3; }));
  executor_->remove_node(node);
}

}  // namespace
}  // namespace agnocastlib
