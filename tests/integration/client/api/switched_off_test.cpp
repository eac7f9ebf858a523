// SPDX-License-Identifier: Apache-2.0
//
// Goal: AGNOCAST=off makes endpoints that do nothing and say so, without daemon and hook. Method:
// this program has no hook, and no daemon runs.

#include <agnocast/agnocast.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <gtest/gtest.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <iterator>
#include <memory>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

struct Numbers {
  std::vector<int> numbers;
};

struct Sum {
  struct Request {
    int a = 0, b = 0;
  };
  struct Response {
    int sum = 0;
  };
};

}  // namespace

template <>
struct MessageTraits<Numbers> {
  static constexpr const char* name = "tests/Numbers";
};
template <>
struct MessageTraits<Sum::Request> {
  static constexpr const char* name = "tests/srv/Sum_Request";
};
template <>
struct MessageTraits<Sum::Response> {
  static constexpr const char* name = "tests/srv/Sum_Response";
};

namespace {

using test::PlainNode;

class SwitchedOff : public testing::Test {
 protected:
  void SetUp() override {
    ::setenv("AGNOCAST", "off", 1);
    ::setenv("AGNOCAST_SOCKET", "/nonexistent/agnocastd.sock", 1);
  }
};

std::ptrdiff_t thread_count() {
  const std::filesystem::directory_iterator tasks("/proc/self/task");
  return std::distance(begin(tasks), end(tasks));
}

TEST_F(SwitchedOff, ServicesAndClientsAreMadeAndDoNothing) {
  const std::ptrdiff_t threads_before = thread_count();
  auto service = create_service<Sum>(PlainNode(), "sum", [](ServiceRequest<Sum>) { FAIL(); });
  auto client = create_client<Sum>(PlainNode(), "sum");
  EXPECT_FALSE(service->is_active());
  EXPECT_FALSE(client->is_active());
  EXPECT_FALSE(client->service_is_ready());
  EXPECT_FALSE(client->wait_for_service()) << "it would wait for ever";
  auto request = client->borrow_loaned_request();
  const auto sent = client->try_async_send_request(std::move(request));
  ASSERT_FALSE(sent);
  EXPECT_EQ(sent.error().code, Errc::switched_off);
  EXPECT_TRUE(request);
  EXPECT_EQ(thread_count(), threads_before);
}

TEST_F(SwitchedOff, EndpointsAreMadeAndDoNothing) {
  const std::ptrdiff_t threads_before = thread_count();
  auto publisher = create_publisher<Numbers>(PlainNode(), "numbers", 1);
  auto asked = create_subscription<Numbers>(PlainNode(), "numbers", QoS(1));
  auto called = create_subscription<Numbers>(PlainNode(), "numbers", QoS(1),
                                             [](const ipc_shared_ptr<const Numbers>&) { FAIL(); });
  EXPECT_FALSE(publisher->is_active());
  EXPECT_FALSE(asked->is_active());
  EXPECT_FALSE(called->is_active());
  EXPECT_STREQ(publisher->get_topic_name(), "/ns/numbers");

  auto loan = publisher->borrow_loaned_message();
  loan->numbers.assign(1000, 7);
  {
    const LoanScope scope(loan);
    EXPECT_FALSE(scope.is_open());
    const LoanPause pause;
    loan->numbers.push_back(8);
  }
  EXPECT_TRUE(publisher->pause(loan));
  EXPECT_EQ(publisher->publish(std::move(loan)).code, Errc::switched_off);
  ASSERT_TRUE(loan);
  EXPECT_EQ(loan->numbers.size(), 1001u);
  auto message = std::make_unique<Numbers>();
  EXPECT_EQ(publisher->publish_for(std::move(message), std::chrono::hours(1)).code,
            Errc::switched_off);
  EXPECT_NE(message, nullptr);
  EXPECT_TRUE(publisher->wait_for_all_acked()) << "nothing was published";
  EXPECT_EQ(publisher->get_actual_qos().depth(), 1u);
  EXPECT_FALSE(asked->take());
  ipc_shared_ptr<const Numbers> batch[2];
  EXPECT_EQ(asked->take_batch(batch, 2), 0u);
  EXPECT_EQ(asked->get_lost_count(), 0u);
  EXPECT_EQ(asked->get_publisher_count(), 0u);
  EXPECT_EQ(publisher->get_subscription_count(), 0u);
  EXPECT_EQ(thread_count(), threads_before) << "no thread was started";
}

TEST_F(SwitchedOff, ExecutorsSpinOverNothing) {
  SingleThreadedExecutor executor;
  executor.add_node(PlainNode());
  auto called = create_subscription<Numbers>(PlainNode(), "numbers", QoS(1),
                                             [](const ipc_shared_ptr<const Numbers>&) { FAIL(); });
  executor.spin_some();
  EXPECT_EQ(called->get_matched_status().current_count, 0u);
}

TEST_F(SwitchedOff, MisuseIsStillReported) {
  EXPECT_EQ(try_create_publisher<Numbers>(PlainNode(), "a//b", QoS(1)).error().code,
            Errc::invalid_name);
  EXPECT_FALSE(try_create_subscription<Numbers>(PlainNode(), "numbers", QoS(0)));
}

TEST_F(SwitchedOff, OnAndEmptyEqualUnsetAndOtherValuesAreRefused) {
  for (const char* value : {"on", ""}) {
    ::setenv("AGNOCAST", value, 1);
    EXPECT_EQ(try_create_publisher<Numbers>(PlainNode(), "numbers", QoS(1)).error().code,
              Errc::daemon_not_running);
  }
  ::setenv("AGNOCAST", "0", 1);
  const auto publisher = try_create_publisher<Numbers>(PlainNode(), "numbers", QoS(1));
  ASSERT_FALSE(publisher);
  EXPECT_EQ(publisher.error().code, Errc::invalid_argument);
  EXPECT_STREQ(publisher.error().what, "AGNOCAST must be on or off");
  const auto subscription = try_create_subscription<Numbers>(PlainNode(), "numbers", QoS(1));
  ASSERT_FALSE(subscription);
  EXPECT_EQ(subscription.error().code, Errc::invalid_argument);
}

}  // namespace
}  // namespace agnocast
