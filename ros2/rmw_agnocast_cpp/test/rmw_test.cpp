// SPDX-License-Identifier: Apache-2.0
//
// Goal: what rcl and its users rely on beyond the headers of rmw: waits that end for nothing but
// what they report, things that end while others use them, loans that nobody gave back, one graph
// condition for each node. Method: the functions of rmw themselves, over a real daemon.

#include <gmock/gmock.h>
#include <rcutils/allocator.h>
#include <rcutils/strdup.h>
#include <rmw/error_handling.h>
#include <rmw/events_statuses/events_statuses.h>
#include <rmw/qos_profiles.h>
#include <rmw/rmw.h>
#include <rosidl_typesupport_cpp/message_type_support.hpp>
#include <rosidl_typesupport_cpp/service_type_support.hpp>
#include <std_msgs/msg/string.hpp>
#include <std_srvs/srv/empty.hpp>

#include <atomic>
#include <chrono>
#include <filesystem>
#include <iterator>
#include <string>
#include <thread>
#include <vector>

namespace {

using namespace std::chrono_literals;
using std_msgs::msg::String;
using std_srvs::srv::Empty;

/// Steps that succeed; the text of the error otherwise.
#define OK(call) ASSERT_EQ(call, RMW_RET_OK) << rmw_get_error_string().str

class Rmw : public testing::Test {
 protected:
  void SetUp() override {
    const rcutils_allocator_t allocator = rcutils_get_default_allocator();
    OK(rmw_init_options_init(&options_, allocator));
    options_.enclave = rcutils_strdup("/", allocator);
    OK(rmw_init(&options_, &context_));
    node_ = rmw_create_node(&context_, "node", "/ns");
    ASSERT_NE(node_, nullptr) << rmw_get_error_string().str;
  }
  void TearDown() override {
    EXPECT_EQ(rmw_destroy_node(node_), RMW_RET_OK);
    if (!is_shut_down_) {
      EXPECT_EQ(rmw_shutdown(&context_), RMW_RET_OK);
    }
    EXPECT_EQ(rmw_context_fini(&context_), RMW_RET_OK);
    EXPECT_EQ(rmw_init_options_fini(&options_), RMW_RET_OK);
  }
  void shut_down() {
    is_shut_down_ = true;
    OK(rmw_shutdown(&context_));
  }

  static const rosidl_message_type_support_t* support() {
    return rosidl_typesupport_cpp::get_message_type_support_handle<String>();
  }
  rmw_publisher_t* publisher(const rmw_qos_profile_t& qos = rmw_qos_profile_default) {
    const rmw_publisher_options_t options = rmw_get_default_publisher_options();
    rmw_publisher_t* const made = rmw_create_publisher(node_, support(), "/topic", &qos, &options);
    EXPECT_NE(made, nullptr) << rmw_get_error_string().str;
    return made;
  }
  rmw_subscription_t* subscription(const rmw_qos_profile_t& qos = rmw_qos_profile_default) {
    const rmw_subscription_options_t options = rmw_get_default_subscription_options();
    rmw_subscription_t* const made =
        rmw_create_subscription(node_, support(), "/topic", &qos, &options);
    EXPECT_NE(made, nullptr) << rmw_get_error_string().str;
    return made;
  }

  rmw_init_options_t options_ = rmw_get_zero_initialized_init_options();
  rmw_context_t context_ = rmw_get_zero_initialized_context();
  rmw_node_t* node_ = nullptr;
  bool is_shut_down_ = false;
};

/// A wait set that waits for guard conditions, subscriptions and events.
class Waiter {
 public:
  explicit Waiter(rmw_context_t& context) : set_(rmw_create_wait_set(&context, 0)) {}
  ~Waiter() { EXPECT_EQ(rmw_destroy_wait_set(set_), RMW_RET_OK); }

  std::vector<void*> conditions, subscriptions, events;

  /// Waits; null means no end. Afterwards what is not ready is null.
  rmw_ret_t wait(const rmw_time_t* timeout = nullptr) {
    rmw_guard_conditions_t all_conditions{conditions.size(), conditions.data()};
    rmw_subscriptions_t all_subscriptions{subscriptions.size(), subscriptions.data()};
    rmw_events_t all_events{events.size(), events.data()};
    return rmw_wait(&all_subscriptions, &all_conditions, nullptr, nullptr, &all_events, set_,
                    timeout);
  }

 private:
  rmw_wait_set_t* const set_;
};

TEST_F(Rmw, AWaitWithoutAnEndEndsForNothingElse) {
  rmw_guard_condition_t* const condition = rmw_create_guard_condition(&context_);
  Waiter waiter(context_);
  waiter.conditions = {condition->data};
  std::atomic<bool> has_ended{false};
  std::thread waits([&] {
    EXPECT_EQ(waiter.wait(), RMW_RET_OK);
    has_ended = true;
  });
  std::this_thread::sleep_for(2500ms);  // two of its own looks
  EXPECT_FALSE(has_ended);
  OK(rmw_trigger_guard_condition(condition));
  waits.join();
  EXPECT_NE(waiter.conditions[0], nullptr);
  OK(rmw_destroy_guard_condition(condition));
}

TEST_F(Rmw, AWaitSurvivesAConditionThatEnds) {
  rmw_guard_condition_t* const ends = rmw_create_guard_condition(&context_);
  rmw_guard_condition_t* const stays = rmw_create_guard_condition(&context_);
  Waiter waiter(context_);
  waiter.conditions = {ends->data, stays->data};
  std::thread waits([&] { EXPECT_EQ(waiter.wait(), RMW_RET_OK); });
  std::this_thread::sleep_for(50ms);
  OK(rmw_destroy_guard_condition(ends));
  OK(rmw_trigger_guard_condition(stays));
  waits.join();
  EXPECT_EQ(waiter.conditions[0], nullptr);
  EXPECT_NE(waiter.conditions[1], nullptr);
  OK(rmw_destroy_guard_condition(stays));
}

TEST_F(Rmw, WaitSetsCostNoDescriptors) {
  const auto descriptors = [] {
    return std::distance(std::filesystem::directory_iterator("/proc/self/fd"), {});
  };
  rmw_guard_condition_t* const condition = rmw_create_guard_condition(&context_);
  const rmw_time_t moment{0, 1'000'000};
  const auto turn = [&] {
    Waiter waiter(context_);
    waiter.conditions = {condition->data};
    EXPECT_EQ(waiter.wait(&moment), RMW_RET_TIMEOUT);
    rmw_reset_error();
  };
  turn();
  const auto before = descriptors();
  for (int i = 0; i < 100; ++i) turn();
  EXPECT_EQ(descriptors(), before);
  OK(rmw_destroy_guard_condition(condition));
}

TEST_F(Rmw, AnEventEndsAWait) {
  rmw_subscription_t* const reader = subscription();
  rmw_event_t event = rmw_get_zero_initialized_event();
  OK(rmw_subscription_event_init(&event, reader, RMW_EVENT_LIVELINESS_CHANGED));
  Waiter waiter(context_);
  waiter.events = {&event};
  rmw_publisher_t* writer = nullptr;
  std::thread publishes([&] { writer = publisher(); });
  OK(waiter.wait());
  publishes.join();
  ASSERT_EQ(waiter.events[0], &event);
  rmw_liveliness_changed_status_t status{};
  bool taken = false;
  OK(rmw_take_event(&event, &status, &taken));
  EXPECT_TRUE(taken);
  EXPECT_EQ(status.alive_count, 1);
  EXPECT_EQ(status.alive_count_change, 1);
  OK(rmw_event_fini(&event));
  OK(rmw_destroy_publisher(node_, writer));
  OK(rmw_destroy_subscription(node_, reader));
}

TEST_F(Rmw, AnEventOfTheOtherKindIsRefused) {
  rmw_subscription_t* const reader = subscription();
  rmw_event_t event = rmw_get_zero_initialized_event();
  EXPECT_EQ(rmw_subscription_event_init(&event, reader, RMW_EVENT_OFFERED_DEADLINE_MISSED),
            RMW_RET_UNSUPPORTED);
  rmw_reset_error();
  OK(rmw_destroy_subscription(node_, reader));
}

TEST_F(Rmw, CallbacksTellWhatIsNew) {
  rmw_subscription_t* const reader = subscription();
  rmw_event_t event = rmw_get_zero_initialized_event();
  OK(rmw_subscription_event_init(&event, reader, RMW_EVENT_LIVELINESS_CHANGED));
  std::atomic<std::size_t> messages{0}, events{0};
  const auto add = [](const void* to, std::size_t count) {
    *static_cast<std::atomic<std::size_t>*>(const_cast<void*>(to)) += count;
  };
  const auto come = [](const std::atomic<std::size_t>& counted, std::size_t count) {
    const auto end = std::chrono::steady_clock::now() + 60s;
    while (counted < count && std::chrono::steady_clock::now() < end)
      std::this_thread::sleep_for(1ms);
    EXPECT_EQ(counted, count);
  };
  OK(rmw_event_set_callback(&event, add, &events));
  rmw_publisher_t* const writer = publisher();
  come(events, 1);
  const String message;
  OK(rmw_publish(writer, &message, nullptr));
  OK(rmw_publish(writer, &message, nullptr));
  OK(rmw_subscription_set_on_new_message_callback(reader, add, &messages));
  come(messages, 2);
  OK(rmw_publish(writer, &message, nullptr));
  come(messages, 3);
  OK(rmw_subscription_set_on_new_message_callback(reader, nullptr, nullptr));
  OK(rmw_publish(writer, &message, nullptr));
  OK(rmw_destroy_publisher(node_, writer));
  come(events, 2);
  EXPECT_EQ(messages, 3u);
  // The callback of the event ends with its subscription.
  OK(rmw_event_fini(&event));
  OK(rmw_destroy_subscription(node_, reader));
}

TEST_F(Rmw, OpenLoansEndWithTheirEndpoints) {
  rmw_publisher_t* const writer = publisher();
  rmw_subscription_t* const reader = subscription();
  ASSERT_TRUE(writer->can_loan_messages);
  ASSERT_TRUE(reader->can_loan_messages);
  void* loans[3] = {};
  for (void*& loan : loans) {
    OK(rmw_borrow_loaned_message(writer, support(), &loan));
    static_cast<String*>(loan)->data = std::string(1'000, 'x');
  }
  OK(rmw_publish_loaned_message(writer, loans[0], nullptr));
  Waiter waiter(context_);
  waiter.subscriptions = {reader->data};
  OK(waiter.wait());
  void* taken_loan = nullptr;
  bool taken = false;
  OK(rmw_take_loaned_message(reader, &taken_loan, &taken, nullptr));
  ASSERT_TRUE(taken);
  EXPECT_EQ(static_cast<const String*>(taken_loan)->data.size(), 1'000u);
  // Neither the two loans nor the message are given back.
  shut_down();
  OK(rmw_destroy_publisher(node_, writer));
  OK(rmw_destroy_subscription(node_, reader));
}

TEST_F(Rmw, WhatANodeHasJustDoneIsThere) {
  const auto count = [&](auto* counted) {
    std::size_t found = 0;
    EXPECT_EQ(counted(node_, "/topic", &found), RMW_RET_OK);
    return found;
  };
  rmw_publisher_t* const writer = publisher();
  while (count(&rmw_count_publishers) != 1) std::this_thread::sleep_for(1ms);  // the first state
  rmw_subscription_t* const reader = subscription();
  EXPECT_EQ(count(&rmw_count_subscribers), 1u);
  const String message;
  OK(rmw_publish(writer, &message, nullptr));
  OK(rmw_publisher_wait_for_all_acked(writer, {0, 0}));
  OK(rmw_destroy_subscription(node_, reader));
  EXPECT_EQ(count(&rmw_count_subscribers), 0u);
  OK(rmw_destroy_publisher(node_, writer));
  EXPECT_EQ(count(&rmw_count_publishers), 0u);
}

TEST_F(Rmw, EndpointsMayBeUsedAfterTheShutdown) {
  rmw_publisher_t* const writer = publisher();
  rmw_subscription_t* const reader = subscription();
  shut_down();
  String message;
  bool taken = false;
  std::size_t count = 0;
  // Whatever they return.
  for ([[maybe_unused]] const rmw_ret_t result :
       {rmw_publish(writer, &message, nullptr), rmw_take(reader, &message, &taken, nullptr),
        rmw_publisher_count_matched_subscriptions(writer, &count)}) {
  }
  rmw_reset_error();
  OK(rmw_destroy_subscription(node_, reader));
  OK(rmw_destroy_publisher(node_, writer));
}

TEST_F(Rmw, EachNodeHasOneGraphCondition) {
  const rmw_guard_condition_t* const condition = rmw_node_get_graph_guard_condition(node_);
  EXPECT_EQ(rmw_node_get_graph_guard_condition(node_), condition);
  rmw_node_t* const other = rmw_create_node(&context_, "other", "/");
  ASSERT_NE(other, nullptr);
  const rmw_guard_condition_t* const others = rmw_node_get_graph_guard_condition(other);
  EXPECT_NE(others, condition);
  Waiter waiter(context_), waiter_of_other(context_);
  rmw_publisher_t* const writer = publisher();
  for (auto& [waits, on] : {std::pair{&waiter, condition}, {&waiter_of_other, others}}) {
    std::size_t count = 0;
    while (count == 0) {  // several changes may come before it
      waits->conditions = {on->data};
      OK(waits->wait());
      OK(rmw_count_publishers(node_, "/topic", &count));
    }
  }
  OK(rmw_destroy_publisher(node_, writer));
  OK(rmw_destroy_node(other));
}

TEST_F(Rmw, AServerThatIsMatchedChangesTheGraph) {
  const auto* const of_service = rosidl_typesupport_cpp::get_service_type_support_handle<Empty>();
  const rmw_qos_profile_t& qos = rmw_qos_profile_services_default;
  rmw_client_t* const client = rmw_create_client(node_, of_service, "/service", &qos);
  ASSERT_NE(client, nullptr) << rmw_get_error_string().str;
  const rmw_guard_condition_t* const condition = rmw_node_get_graph_guard_condition(node_);
  Waiter waiter(context_);
  for (int turn = 0; turn < 300; ++turn) {
    rmw_service_t* server = nullptr;
    std::thread creates([&] { server = rmw_create_service(node_, of_service, "/service", &qos); });
    bool is_there = false;
    for (;;) {
      OK(rmw_service_server_is_available(node_, client, &is_there));
      if (is_there) break;
      waiter.conditions = {condition->data};
      OK(waiter.wait());
    }
    creates.join();
    ASSERT_NE(server, nullptr) << rmw_get_error_string().str;
    OK(rmw_destroy_service(node_, server));
    while (is_there) OK(rmw_service_server_is_available(node_, client, &is_there));
  }
  OK(rmw_destroy_client(node_, client));
}

TEST_F(Rmw, ProfilesGoTogetherAsDdsSays) {
  rmw_qos_profile_t offered = rmw_qos_profile_default, requested = rmw_qos_profile_default;
  const auto judged = [&] {
    rmw_qos_compatibility_type_t result{};
    char reason[256] = "";
    EXPECT_EQ(rmw_qos_profile_check_compatible(offered, requested, &result, reason, sizeof reason),
              RMW_RET_OK);
    EXPECT_EQ(result == RMW_QOS_COMPATIBILITY_OK, std::string(reason).empty()) << reason;
    return result;
  };
  EXPECT_EQ(judged(), RMW_QOS_COMPATIBILITY_OK);
  offered.reliability = RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
  EXPECT_EQ(judged(), RMW_QOS_COMPATIBILITY_ERROR);
  requested.reliability = RMW_QOS_POLICY_RELIABILITY_SYSTEM_DEFAULT;
  EXPECT_EQ(judged(), RMW_QOS_COMPATIBILITY_WARNING);
  requested = offered;
  requested.deadline = {1, 0};
  EXPECT_EQ(judged(), RMW_QOS_COMPATIBILITY_ERROR) << "none is offered";
  offered.deadline = {0, 500'000'000};
  EXPECT_EQ(judged(), RMW_QOS_COMPATIBILITY_OK);
  requested.durability = RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL;
  EXPECT_EQ(judged(), RMW_QOS_COMPATIBILITY_ERROR);
}

}  // namespace
