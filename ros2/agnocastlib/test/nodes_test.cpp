// SPDX-License-Identifier: Apache-2.0
//
// agnocast::Node and timers.

#include "common.hpp"

#include <rosgraph_msgs/msg/clock.hpp>
#include <std_srvs/srv/trigger.hpp>

#include <atomic>
#include <functional>
#include <map>
#include <stdexcept>

namespace agnocastlib {
namespace {

using Trigger = std_srvs::srv::Trigger;

class NodesTest : public AgnocastTest {
 protected:
  template <class Condition>
  static bool spin_until(const agnocast::Node::SharedPtr& node, Condition condition) {
    agnocast::AgnocastOnlySingleThreadedExecutor executor;
    executor.add_node(node);
    const Spinning spinning(executor);
    return eventually(condition);
  }
};

/// A class as people write it.
class Echo : public agnocast::Node {
 public:
  explicit Echo(const rclcpp::NodeOptions& options = rclcpp::NodeOptions())
      : agnocast::Node("echo", "/space", options) {
    declare_parameter("topic", rclcpp::ParameterValue(std::string("in")));
    declare_parameter<int>("qos.depth", 3);
    get_parameter("topic", topic_);
    std::map<std::string, rclcpp::Parameter> qos;
    get_parameters("qos", qos);
    const auto group = create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
    agnocast::SubscriptionOptions subscription_options;
    subscription_options.callback_group = group;
    group_ = group;
    subscription_ = create_subscription<String>(
        topic_, rclcpp::QoS(rclcpp::KeepLast(qos["depth"].as_int())),
        std::bind(&Echo::callback, this, std::placeholders::_1), subscription_options);
    publisher_ = create_publisher<String>("out", 10);
  }

 private:
  void callback(const agnocast::ipc_shared_ptr<String>& message) {
    publish(*publisher_, "heard " + message->data);
  }

  std::string topic_;
  rclcpp::CallbackGroup::SharedPtr group_;
  agnocast::Subscription<String>::SharedPtr subscription_;
  agnocast::Publisher<String>::SharedPtr publisher_;
};

TEST_F(NodesTest, NamesAreStrings) {
  const Echo echo;
  EXPECT_EQ(echo.get_name().size(), 4u);
  EXPECT_EQ(echo.get_namespace(), "/space");
  EXPECT_EQ(echo.get_fully_qualified_name(), "/space/echo");
}

TEST_F(NodesTest, ParametersAndEndpointsWork) {
  const auto echo =
      std::make_shared<Echo>(rclcpp::NodeOptions().parameter_overrides({{"topic", "elsewhere"}}));
  const auto node = std::make_shared<agnocast::Node>("node", "/space");
  const auto source = node->create_publisher<String>("elsewhere", rclcpp::QoS(10));
  const auto answers = node->create_subscription<String>("out", rclcpp::QoS(1));
  ASSERT_TRUE(eventually([&] { return source->get_linked_subscription_count() == 1; }));
  EXPECT_EQ(node->count_publishers("elsewhere"), 1u);
  EXPECT_EQ(node->count_subscribers("elsewhere"), 1u);
  EXPECT_EQ(node->count_subscribers("/nobody"), 0u);
  publish(*source, "words");
  EXPECT_TRUE(spin_until(echo, [&] {
    const auto answer = answers->take_data();
    return answer && answer->data == "heard words";
  }));
}

TEST_F(NodesTest, ManyThreadsCountAtOnce) {
  const auto node = std::make_shared<agnocast::Node>("node");
  const auto publisher = node->create_publisher<String>("counted", 1);
  ASSERT_TRUE(eventually([&] { return node->count_publishers("counted") == 1; }));
  std::vector<std::thread> threads;
  std::atomic<int> wrong{0};
  for (int i = 0; i < 16; ++i)
    threads.emplace_back([&] {
      for (int j = 0; j < 100; ++j) wrong += node->count_publishers("counted") != 1;
    });
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(wrong, 0);
}

TEST_F(NodesTest, ServicesAreThoseOfAgnocast) {
  const auto node = std::make_shared<agnocast::Node>("node");
  const auto service = node->create_service<Trigger>(
      "service",
      [](const agnocast::ipc_shared_ptr<Trigger::Request>&,
         agnocast::ipc_shared_ptr<Trigger::Response>& response) { response->message = "done"; });
  const auto client = node->create_client<Trigger>("service");
  ASSERT_TRUE(client->wait_for_service(30s));
  auto sent = client->async_send_request(client->borrow_loaned_request());
  EXPECT_TRUE(spin_until(node, [&] { return sent.wait_for(0s) == std::future_status::ready; }));
  EXPECT_EQ(sent.get()->message, "done");
}

TEST_F(NodesTest, InitMayComeAfterThatOfRclcpp) {
  EXPECT_TRUE(agnocast::ok());
  agnocast::init(0, nullptr);
  EXPECT_TRUE(agnocast::ok());
  agnocast::shutdown();
  EXPECT_FALSE(agnocast::ok());
  EXPECT_FALSE(rclcpp::ok());
}

TEST_F(NodesTest, WallTimersRunAndStop) {
  const auto node = std::make_shared<agnocast::Node>("node");
  std::atomic<int> plain{0}, with_timer{0}, later{0};
  const agnocast::TimerBase::SharedPtr first = node->create_wall_timer(1ms, [&] { ++plain; });
  const auto second = node->create_wall_timer(1ms, [&](agnocast::TimerBase& timer) {
    if (++with_timer == 3) timer.cancel();
  });
  const auto third = node->create_wall_timer(
      1ms, [&] { ++later; }, nullptr, false);
  EXPECT_TRUE(first->is_steady());
  EXPECT_EQ(first->get_clock()->get_clock_type(), RCL_STEADY_TIME);
  EXPECT_TRUE(third->is_canceled()) << "autostart is false";
  agnocast::AgnocastOnlySingleThreadedExecutor executor;
  executor.add_node(node);
  const Spinning spinning(executor);
  EXPECT_TRUE(eventually([&] { return plain >= 20 && second->is_canceled(); }));
  EXPECT_EQ(with_timer, 3);
  EXPECT_EQ(later, 0);
  third->reset();
  EXPECT_TRUE(eventually([&] { return later > 0; }));
  first->set_period(1h);
  first->reset();
  EXPECT_GT(first->time_until_trigger(), 50min);
}

TEST_F(NodesTest, ATimerEndsWithItsHandle) {
  const auto node = std::make_shared<rclcpp::Node>("node");
  std::atomic<int> count{0};
  agnocast::TimerBase::SharedPtr timer =
      agnocast::create_timer(node, node->get_clock(), rclcpp::Duration(1ms), [&] { ++count; });
  agnocast::SingleThreadedAgnocastExecutor executor;
  executor.add_node(node);
  const Spinning spinning(executor);
  EXPECT_TRUE(eventually([&] { return count > 0; }));
  timer.reset();
  // One thread: what the ended timer had begun is over when another one runs.
  std::atomic<int> others{0};
  const auto other =
      agnocast::create_timer(node, node->get_clock(), rclcpp::Duration(1ms), [&] { ++others; });
  EXPECT_TRUE(eventually([&] { return others > 0; }));
  const int before = count;
  EXPECT_TRUE(eventually([&] { return others > 20; }));
  EXPECT_EQ(count, before);
}

TEST_F(NodesTest, TimersOfTheRosClockFollowSimulatedTime) {
  const auto node = std::make_shared<agnocast::Node>(
      "node", rclcpp::NodeOptions().parameter_overrides({{"use_sim_time", true}}));
  EXPECT_TRUE(node->get_parameter("use_sim_time").as_bool());
  const auto clock = node->rclcpp::Node::create_publisher<rosgraph_msgs::msg::Clock>("/clock", 10);
  std::atomic<int> of_free_function{0}, of_member{0};
  const auto first = agnocast::create_timer(node.get(), node->get_clock(), rclcpp::Duration(500ms),
                                            [&] { ++of_free_function; });
  const auto second = node->create_timer(500ms, [&] { ++of_member; });
  EXPECT_FALSE(first->is_steady());
  agnocast::AgnocastOnlySingleThreadedExecutor executor;
  executor.add_node(node);
  const Spinning spinning(executor);
  std::this_thread::sleep_for(700ms);
  EXPECT_EQ(of_free_function, 0) << "no simulated time has passed";
  rosgraph_msgs::msg::Clock time;
  EXPECT_TRUE(eventually([&] {
    time.clock.sec += 1;
    clock->publish(time);
    std::this_thread::sleep_for(20ms);
    return of_free_function >= 2 && of_member >= 2;
  }));
}

TEST_F(NodesTest, TimersRefuseNonsense) {
  const auto node = std::make_shared<agnocast::Node>("node");
  EXPECT_THROW(agnocast::create_timer(node, nullptr, rclcpp::Duration(1ms), [] {}),
               std::invalid_argument);
  EXPECT_THROW(node->create_wall_timer(-1ms, [] {}), std::invalid_argument);
}

}  // namespace
}  // namespace agnocastlib
