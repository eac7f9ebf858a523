// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process without the heap hook publishes: each message arrives as it was, its memory is
// free again afterwards, and a full heap is reported.
// Method: this program has no hook. Publisher and subscription in this process, and a second
// process without the hook; the real daemon; random messages of every kind of type.

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>
#include <tests/support/messages/random_message.hpp>
#include <tests/support/processes/child.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gmock/gmock.h>

#include <every_message_name.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <std_msgs/msg/string.hpp>
#include <std_srvs/srv/set_bool.hpp>
#include <test_msgs/msg/arrays.hpp>
#include <test_msgs/msg/bounded_sequences.hpp>
#include <test_msgs/msg/nested.hpp>
#include <test_msgs/msg/unbounded_sequences.hpp>
#include <test_msgs/msg/w_strings.hpp>

#include <chrono>
#include <cstdint>
#include <future>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using sensor_msgs::msg::PointCloud2;
using std_srvs::srv::SetBool;
using test::PlainNode;
using test::take_soon;

constexpr std::size_t window_bytes = std::size_t{64} << 20;
const std::string long_text = "a text that does not fit into a string object";

PointCloud2 cloud_of(std::size_t bytes) {
  PointCloud2 cloud;
  cloud.header.frame_id = long_text;
  cloud.fields.resize(3);
  for (auto& field : cloud.fields) field.name = long_text;
  cloud.data.assign(bytes, 7);
  return cloud;
}

int publish_and_stay() {
  const auto publisher =
      try_create_publisher<PointCloud2>(PlainNode(), "theirs", QoS(1).reliable().transient_local());
  if (!publisher || !(*publisher)->publish(cloud_of(100'000))) return 1;
  return test::sleep_for_ever();
}

class Copying : public test::SuiteDaemon {
 protected:
  static void SetUpTestSuite() {
    start({.config =
               "[heap]\n" AGNOCAST_TEST_ARENA_BASE
               "window_bytes = \"64MiB\"\narena_bytes = \"1GiB\"\nwindows_per_process = 1\n"});
    // Forked before this process uses the library.
    other = std::make_unique<test::Child>(publish_and_stay);
  }
  static void TearDownTestSuite() {
    other.reset();
    SuiteDaemon::TearDownTestSuite();
  }
  PlainNode node;
  inline static std::unique_ptr<test::Child> other;
};

TEST_F(Copying, EveryTypeArrivesAsItWasByItsName) {
  test::RandomMessages random(12, {.has_nan = true, .has_any_text = true});
  int count = 0;
  for (const char* const name : test::every_message_name) {
    SCOPED_TRACE(name);
    const std::string topic = own("t" + std::to_string(count++));
    const IntrospectedType type = find_message_type(name);
    const MessageMembers& members = type.members();
    auto subscription = create_generic_subscription(node, topic, name, QoS(5));
    auto publisher = create_generic_publisher(node, topic, name, QoS(5));
    const OwnedGenericMessage sent = type.make();
    random.fill(members, sent.get());
    const auto expect_arrival = [&](const PublishResult& result) {
      ASSERT_TRUE(result) << word_of(result.code);
      EXPECT_GE(result.adopted_bytes, members.size_of_) << "all of it is copied, and reported";
      const GenericMessage message = take_soon(subscription);
      ASSERT_TRUE(message);
      EXPECT_TRUE(test::are_same(members, message.get(), sent.get()));
      EXPECT_EQ(message.info().object_bytes, members.size_of_);
    };
    GenericLoan loan = publisher->borrow_loaned_message();
    ASSERT_TRUE(loan);
    type.assign(sent.get(), loan.get());
    expect_arrival(publisher->publish(std::move(loan)));
    EXPECT_FALSE(loan);
    expect_arrival(publisher->publish(type.copy(sent.get())));
  }
  EXPECT_GE(count, 40);
}

template <class T>
void expect_arrival_from_each_publish(const std::string& topic) {
  SCOPED_TRACE(topic);
  const PlainNode node;
  auto subscription = create_subscription<T>(node, topic, QoS(5));
  auto publisher = create_publisher<T>(node, topic, QoS(5));
  T sent;
  test::RandomMessages(12, {.has_nan = false, .has_any_text = true})
      .fill(find_message_type(rosidl_generator_traits::name<T>()).members(), &sent);
  const auto expect_arrival = [&](const PublishResult& result) {
    ASSERT_TRUE(result) << word_of(result.code);
    EXPECT_GE(result.adopted_bytes, sizeof sent);
    const auto message = take_soon(subscription);
    ASSERT_TRUE(message);
    EXPECT_EQ(*message, sent);
    EXPECT_EQ(T(*message), sent);
  };
  auto loan = publisher->borrow_loaned_message();
  *loan = sent;
  expect_arrival(publisher->publish(std::move(loan)));
  EXPECT_FALSE(loan);
  expect_arrival(publisher->publish(std::make_unique<T>(sent)));
  expect_arrival(publisher->publish(sent));
}

TEST_F(Copying, TypedMessagesArriveAsTheyWereFromEachPublish) {
  expect_arrival_from_each_publish<test_msgs::msg::Arrays>(own("arrays"));
  expect_arrival_from_each_publish<test_msgs::msg::BoundedSequences>(own("bounded"));
  expect_arrival_from_each_publish<test_msgs::msg::Nested>(own("nested"));
  expect_arrival_from_each_publish<test_msgs::msg::UnboundedSequences>(own("unbounded"));
  expect_arrival_from_each_publish<test_msgs::msg::WStrings>(own("wide"));
}

TEST_F(Copying, AMessageOfAnotherProcessArrivesAndIsForwarded) {
  const QoS latched = QoS(1).reliable().transient_local();
  auto theirs = create_subscription<PointCloud2>(node, "theirs", latched);
  const auto received = take_soon(theirs);
  ASSERT_TRUE(received);
  EXPECT_EQ(*received, cloud_of(100'000));
  auto publisher = create_publisher<PointCloud2>(node, own("forwarded"), latched);
  ASSERT_TRUE(publisher->publish(*received));
  auto subscription = create_subscription<PointCloud2>(node, own("forwarded"), latched);
  const auto forwarded = take_soon(subscription);
  ASSERT_TRUE(forwarded);
  EXPECT_EQ(*forwarded, *received);
}

TEST_F(Copying, MemoryIsUsedAgain) {
  auto subscription = create_subscription<PointCloud2>(node, own("clouds"), QoS(3));
  auto publisher = create_publisher<PointCloud2>(node, own("clouds"), QoS(3));
  for (std::uint32_t i = 0; i < 300; ++i) {
    PointCloud2 cloud = cloud_of(1'000'000 + i * 1000);
    cloud.width = i;
    ASSERT_TRUE(publisher->publish(std::make_unique<PointCloud2>(std::move(cloud)))) << i;
    const auto message = take_soon(subscription);
    ASSERT_TRUE(message);
    ASSERT_EQ(message->width, i);
    ASSERT_EQ(message->data.size(), 1'000'000 + i * 1000);
  }
}

TEST_F(Copying, AFullHeapIsReportedAndTheMessageStays) {
  auto subscription = create_subscription<PointCloud2>(node, own("clouds"), QoS(20).reliable());
  auto publisher = create_publisher<PointCloud2>(node, own("clouds"), QoS(20).reliable());
  std::vector<ipc_shared_ptr<const PointCloud2>> held;
  auto loan = publisher->borrow_loaned_message();
  *loan = cloud_of(window_bytes / 5);
  PublishResult result;
  while (held.size() < 10 && (result = publisher->publish(std::as_const(*loan)))) {
    held.push_back(take_soon(subscription));
    ASSERT_TRUE(held.back());
  }
  EXPECT_TRUE(result.code == Errc::heap_exhausted || result.code == Errc::window_exhausted)
      << word_of(result.code);
  EXPECT_EQ(held.size(), 4U);
  EXPECT_FALSE(publisher->publish(std::move(loan)));
  ASSERT_TRUE(loan) << "the caller still owns it";
  EXPECT_EQ(*loan, cloud_of(window_bytes / 5));
  held.clear();
  EXPECT_TRUE(publisher->publish_for(std::move(loan), std::chrono::seconds(1)));
}

TEST_F(Copying, AKeepAllPublisherWaitsWithItsCopy) {
  const QoS qos = QoS(2).reliable().keep_all(2);
  auto subscription = create_subscription<std_msgs::msg::String>(node, own("texts"), qos);
  auto publisher = create_publisher<std_msgs::msg::String>(node, own("texts"), qos);
  std_msgs::msg::String text;
  PublishResult result;
  int published = 0;
  do {
    text.data = long_text + std::to_string(published);
  } while ((result = publisher->publish(text)) && ++published < 100);
  ASSERT_EQ(result.code, Errc::would_block);
  auto reader = std::async(std::launch::async, [&] {
    std::vector<std::string> texts;
    while (texts.size() < static_cast<std::size_t>(published) + 1) {
      const auto message = take_soon(subscription);
      if (!message) break;
      texts.push_back(message->data);
    }
    return texts;
  });
  EXPECT_TRUE(publisher->publish_for(text, std::chrono::minutes(1)));
  const auto texts = reader.get();
  ASSERT_EQ(texts.size(), static_cast<std::size_t>(published) + 1);
  for (std::size_t i = 0; i < texts.size(); ++i) EXPECT_EQ(texts[i], long_text + std::to_string(i));
}

TEST_F(Copying, ServicesAnswer) {
  BackgroundExecutor executor;
  Node server("server");
  auto service = create_service<SetBool>(&server, own("service"),
                                         [](const ipc_shared_ptr<const SetBool::Request>& request,
                                            ipc_shared_ptr<SetBool::Response>& response) {
                                           response->success = request->data;
                                           response->message = long_text;
                                         });
  auto client = create_client<SetBool>(&server, own("service"));
  executor.add_node(&server);
  ASSERT_TRUE(client->wait_for_service(std::chrono::minutes(5)));
  auto request = client->borrow_loaned_request();
  request->data = true;
  auto future = client->async_send_request(std::move(request));
  ASSERT_EQ(future.wait_for(std::chrono::minutes(5)), std::future_status::ready);
  const auto response = future.get();
  EXPECT_TRUE(response->success);
  EXPECT_EQ(response->message, long_text);
}

TEST_F(Copying, AWaitingLoanIsCopiedOnce) {
  const QoS qos = QoS(1).reliable().keep_all(1);
  auto subscription = create_subscription<PointCloud2>(node, own("clouds"), qos);
  auto publisher = create_publisher<PointCloud2>(node, own("clouds"), qos);
  const PublishResult first = publisher->publish(cloud_of(1000));
  ASSERT_TRUE(first);
  while (publisher->publish(cloud_of(1000))) {
  }
  auto reader = std::async(std::launch::async, [&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(100));  // many attempts
    while (take_soon(subscription)->data.size() == 1000) {
    }
  });
  auto loan = publisher->borrow_loaned_message();
  *loan = cloud_of(2000);
  const PublishResult waited = publisher->publish_for(std::move(loan), std::chrono::minutes(5));
  reader.get();
  ASSERT_TRUE(waited);
  EXPECT_EQ(waited.adopted_bytes, first.adopted_bytes + 1000);
  EXPECT_FALSE(loan);
}

TEST_F(Copying, ThreadsPublishBesideEachOther) {
  constexpr std::uint32_t thread_count = 4, each = 250;
  auto subscription =
      create_subscription<PointCloud2>(node, own("clouds"), QoS(thread_count * each).reliable());
  std::vector<std::future<bool>> threads;
  for (std::uint32_t t = 0; t < thread_count; ++t) {
    threads.push_back(std::async(std::launch::async, [&, t] {
      auto publisher = create_publisher<PointCloud2>(node, own("clouds"), QoS(each).reliable());
      bool is_well = true;
      for (std::uint32_t i = 0; i < each; ++i) {
        PointCloud2 cloud = cloud_of(1 + (i * 97) % 5000);
        cloud.width = t;
        cloud.height = i;
        is_well = publisher->publish(cloud) && is_well;
      }
      return is_well && publisher->wait_for_all_acked();
    }));
  }
  std::vector<std::uint32_t> next(thread_count, 0);
  for (std::uint32_t i = 0; i < thread_count * each; ++i) {
    const auto message = take_soon(subscription);
    ASSERT_TRUE(message);
    ASSERT_LT(message->width, thread_count);
    PointCloud2 expected = cloud_of(1 + (message->height * 97) % 5000);
    expected.width = message->width;
    expected.height = next[message->width]++;
    ASSERT_EQ(*message, expected);
  }
  for (auto& thread : threads) EXPECT_TRUE(thread.get());
}

TEST_F(Copying, AForkedChildReadsWhatItsParentHeld) {
  auto subscription = create_subscription<PointCloud2>(node, own("clouds"), QoS(1));
  auto publisher = create_publisher<PointCloud2>(node, own("clouds"), QoS(1));
  ASSERT_TRUE(publisher->publish(cloud_of(100'000)));
  const auto held = take_soon(subscription);
  ASSERT_TRUE(held);
  test::Child child([&] {
    const bool is_readable = *held == cloud_of(100'000);
    const bool is_refused = publisher->publish(cloud_of(1)).code == Errc::shut_down;
    return is_readable && is_refused ? 0 : 1;
  });
  EXPECT_EQ(child.wait(), 0);
  EXPECT_EQ(*held, cloud_of(100'000));
  EXPECT_TRUE(publisher->publish(cloud_of(1)));
}

TEST_F(Copying, ScopesHaveNoEffect) {
  auto publisher = create_publisher<PointCloud2>(node, own("clouds"), QoS(1));
  const auto loan = publisher->borrow_loaned_message();
  EXPECT_FALSE(LoanScope(loan).is_open());
  EXPECT_FALSE(SharedHeapScope().is_open());
  const LoanPause pause;
  EXPECT_TRUE(publisher->publish(cloud_of(10)));
}

}  // namespace
}  // namespace agnocast
