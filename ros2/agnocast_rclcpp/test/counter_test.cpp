// SPDX-License-Identifier: Apache-2.0
//
// Goal: callbacks of agnocast and of rclcpp in one callback group exclude each other, and none is
// lost. Method: a timer, a subscription of rclcpp's, one of ours, a service of ours and a parameter
// callback of one node add to a counter without a guard, in every executor of rclcpp's; the sum of
// atomic counters says what it must be. In a reentrant group the same callbacks overlap and none is
// lost. AGNOCAST_TEST_CALLBACKS: how many callbacks (default 10000).

#include "test_node.hpp"

#include <rclcpp/parameter_client.hpp>
#include <std_srvs/srv/trigger.hpp>

#include <cstdint>
#include <cstdlib>
#include <future>
#include <vector>

namespace agnocast_rclcpp {
namespace {

using Trigger = std_srvs::srv::Trigger;
using namespace std::chrono_literals;

std::uint64_t wanted_callbacks() {
  const char* const text = std::getenv("AGNOCAST_TEST_CALLBACKS");
  return text != nullptr ? std::strtoull(text, nullptr, 10) : 10'000;
}

/// What the callbacks do. The volatile counter loses additions if two run at once.
class Counter {
 public:
  /// `stay`: how long each callback takes at least.
  explicit Counter(std::chrono::microseconds stay) : stay_(stay) {}
  void add(std::atomic<std::uint64_t>& kind) {
    // The parameter callback is always in the default group, so it says nothing of another one.
    const bool is_ours = &kind == &ours || &kind == &service;
    if (inside_.fetch_add(1) != 0) ++overlaps;
    if (is_ours && ours_inside_.fetch_add(1) != 0) ++overlaps_of_ours;
    unguarded = unguarded + 1;
    if (stay_ != stay_.zero()) std::this_thread::sleep_for(stay_);
    ++kind;
    if (is_ours) ours_inside_.fetch_sub(1);
    inside_.fetch_sub(1);
  }
  std::uint64_t sum() const { return timer + theirs + ours + service + parameter; }

  volatile std::uint64_t unguarded = 0;
  std::atomic<std::uint64_t> overlaps{0}, overlaps_of_ours{0};
  std::atomic<std::uint64_t> timer{0}, theirs{0}, ours{0}, service{0}, parameter{0};

 private:
  const std::chrono::microseconds stay_;
  std::atomic<int> inside_{0}, ours_inside_{0};
};

class CounterTest : public RclcppTest, public testing::WithParamInterface<const ExecutorKind*> {
 protected:
  void count_in(bool is_reentrant);
};

// Long because five kinds of callbacks and who causes them make one scene.
void CounterTest::count_in(bool is_reentrant) {
  const auto node = std::make_shared<rclcpp::Node>("counted");
  Counter counter(is_reentrant ? 50us : 0us);
  // Otherwise all in the default group, where the parameter services always are.
  const auto group =
      is_reentrant ? node->create_callback_group(rclcpp::CallbackGroupType::Reentrant) : nullptr;
  rclcpp::SubscriptionOptions options;
  options.callback_group = group;
  const auto timer = node->create_wall_timer(
      1ms, [&] { counter.add(counter.timer); }, group);
  const auto theirs = node->create_subscription<String>(
      "theirs", 1000, [&](const String&) { counter.add(counter.theirs); }, options);
  const auto ours = agnocast::create_subscription<String>(
      node, "ours", 1000,
      [&](const agnocast::ipc_shared_ptr<const String>&) { counter.add(counter.ours); }, options);
  const auto service = agnocast::create_service<Trigger>(
      node, "service",
      [&](const agnocast::ipc_shared_ptr<const Trigger::Request>&,
          agnocast::ipc_shared_ptr<Trigger::Response>& response) {
        counter.add(counter.service);
        response->success = true;
      },
      rclcpp::ServicesQoS(), group);
  const auto parameter =
      node->add_on_set_parameters_callback([&](const std::vector<rclcpp::Parameter>&) {
        counter.add(counter.parameter);
        rcl_interfaces::msg::SetParametersResult result;
        result.successful = true;
        return result;
      });
  node->declare_parameter("number", 0);
  const std::uint64_t declared = counter.parameter;
  auto executor = GetParam()->make();
  executor->add_node(node);

  const auto driver = std::make_shared<rclcpp::Node>("driver");
  const auto to_theirs = driver->create_publisher<String>("theirs", 1000);
  const auto to_ours = agnocast::create_publisher<String>(driver, "ours", 1000);
  const auto client = agnocast::create_client<Trigger>(driver, "service");
  const auto parameters = std::make_shared<rclcpp::AsyncParametersClient>(driver, "counted");
  rclcpp::executors::SingleThreadedExecutor drivers;
  drivers.add_node(driver);
  std::uint64_t published = 0, called = 0;
  std::atomic<std::uint64_t> answered{0};
  {
    SpinningThread spinning(*executor);
    SpinningThread driving(drivers);
    ASSERT_TRUE(parameters->wait_for_service(30s));
    ASSERT_TRUE(client->wait_for_service(30s));
    ASSERT_TRUE(eventually([&] {
      return to_ours->get_subscription_count() == 1 && to_theirs->get_subscription_count() == 1 &&
             theirs->get_publisher_count() == 1;
    }));
    std::future<void> calls = std::async(std::launch::async, [&] {
      while (counter.sum() < wanted_callbacks()) {
        auto request = client->borrow_loaned_request();
        auto sent = client->async_send_request(std::move(request));
        if (sent.wait_for(30s) != std::future_status::ready) break;
        ++called;
        answered += sent.get()->success ? 1 : 0;
      }
    });
    std::future<void> settings = std::async(std::launch::async, [&] {
      for (int number = 1; counter.sum() < wanted_callbacks(); ++number)
        (void)parameters->set_parameters({rclcpp::Parameter("number", number)}).wait_for(30s);
    });
    while (counter.sum() < wanted_callbacks()) {
      // Half of what the queues take.
      while (published - counter.ours > 500 || published - counter.theirs > 500)
        std::this_thread::sleep_for(100us);
      String message;
      message.data = "one";
      to_theirs->publish(message);
      ASSERT_EQ(to_ours->publish(message).code, agnocast::Errc::ok);
      ++published;
    }
    calls.get();
    settings.get();
    EXPECT_TRUE(
        eventually([&] { return counter.ours == published && counter.theirs == published; }));
  }
  EXPECT_EQ(counter.ours, published);
  EXPECT_EQ(counter.theirs, published);
  EXPECT_EQ(counter.service, called);
  EXPECT_EQ(answered, called);
  if (is_reentrant) {
    EXPECT_GT(counter.overlaps_of_ours, 0u);
  } else {
    EXPECT_EQ(counter.unguarded, counter.sum());
    EXPECT_EQ(counter.overlaps, 0u);
  }
  for (const auto* kind : {&counter.timer, &counter.theirs, &counter.ours, &counter.service})
    EXPECT_GT(*kind, 0u);
  EXPECT_GT(counter.parameter, declared);
  RecordProperty("callbacks", std::to_string(counter.sum()));
  std::printf(
      "%s: %ju callbacks: %ju timer, %ju rclcpp's, %ju ours, %ju service, %ju parameter; %ju began "
      "inside another, %ju of ours inside one of ours\n",
      GetParam()->name, std::uintmax_t{counter.sum()}, std::uintmax_t{counter.timer},
      std::uintmax_t{counter.theirs}, std::uintmax_t{counter.ours}, std::uintmax_t{counter.service},
      std::uintmax_t{counter.parameter}, std::uintmax_t{counter.overlaps},
      std::uintmax_t{counter.overlaps_of_ours});
}

TEST_P(CounterTest, IsExactInOneExclusiveGroup) { count_in(false); }

INSTANTIATE_TEST_SUITE_P(Executors, CounterTest,
                         testing::Values(&single_threaded, &static_single_threaded,
                                         &multi_threaded(2), &multi_threaded(4),
                                         &multi_threaded(8)),
                         [](const auto& info) { return std::string(info.param->name); });

class ReentrantTest : public CounterTest {};

TEST_P(ReentrantTest, RunsTwoAtOnceAndLosesNothing) { count_in(true); }

INSTANTIATE_TEST_SUITE_P(Executors, ReentrantTest,
                         testing::Values(&multi_threaded(2), &multi_threaded(4),
                                         &multi_threaded(8)),
                         [](const auto& info) { return std::string(info.param->name); });

}  // namespace
}  // namespace agnocast_rclcpp
