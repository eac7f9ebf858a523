// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process without the heap hook publishes: each message arrives as it was, its memory is
// free again afterwards, a full heap is reported, and what cannot be copied is refused.
// Method: this program has no hook. Publisher and subscription in this process, and a second
// process without the hook; the real daemon; random messages of every kind of type.

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>
#include <tests/support/messages/random_message.hpp>
#include <tests/support/processes/child.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/suite_daemon.hpp>
#include <tests/support/soon.hpp>

#include <gmock/gmock.h>

#include <every_kind_of_message.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <std_msgs/msg/string.hpp>
#include <std_srvs/srv/set_bool.hpp>

#include <chrono>
#include <cstdint>
#include <future>
#include <memory>
#include <string>
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

struct Flat {
  std::uint64_t number = 0;
  alignas(256) std::byte bytes[1000] = {};
};
struct Unknown {
  std::vector<int> numbers;
};
struct OwnMemory : SharedMessage {
  SharedString text;
};

}  // namespace

template <>
struct MessageTraits<Flat> {
  static constexpr const char* name = "tests/Flat";
};
template <>
struct MessageTraits<Unknown> {
  static constexpr const char* name = "tests/Unknown";
};
template <>
struct MessageTraits<OwnMemory> {
  static constexpr const char* name = "tests/OwnMemory";
};

namespace {

PointCloud2 cloud_of(std::size_t bytes) {
  PointCloud2 cloud;
  cloud.header.frame_id = long_text;
  cloud.fields.resize(3);
  for (auto& field : cloud.fields) field.name = long_text;
  cloud.data.assign(bytes, 7);
  return cloud;
}

int publish_and_stay() {
  auto publisher =
      create_publisher<PointCloud2>(PlainNode(), "theirs", QoS(1).reliable().transient_local());
  if (!publisher->publish(cloud_of(100'000))) return 1;
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

TEST_F(Copying, EveryKindOfMessageArrivesAsItWas) {
  test::RandomMessages random(12, {.has_nan = false, .has_any_text = true});
  int count = 0;
  test::for_every_kind_of_message([&](auto* null, const std::string& name) {
    using T = std::remove_pointer_t<decltype(null)>;
    SCOPED_TRACE(name);
    const std::string topic = own("t" + std::to_string(count++));
    const MessageMembers& members = find_message_type(name).members();
    auto subscription = create_subscription<T>(node, topic, QoS(5));
    auto typed = create_publisher<T>(node, topic, QoS(5));
    auto generic = create_generic_publisher(node, topic, name, QoS(5));
    T sent;
    random.fill(members, &sent);
    const auto expect_arrival = [&](const PublishResult& result) {
      ASSERT_TRUE(result) << word_of(result.code);
      EXPECT_GE(result.adopted_bytes, sizeof(T)) << "all of it is copied, and reported";
      const auto message = take_soon(subscription);
      ASSERT_TRUE(message);
      EXPECT_EQ(*message, sent);
      EXPECT_EQ(T(*message), sent);
      EXPECT_EQ(message.info().object_bytes, sizeof(T));
    };
    auto loan = typed->borrow_loaned_message();
    *loan = sent;
    expect_arrival(typed->publish(std::move(loan)));
    EXPECT_FALSE(loan);
    expect_arrival(typed->publish(std::make_unique<T>(sent)));
    expect_arrival(typed->publish(sent));
    GenericLoan of_table = generic->borrow_loaned_message();
    *static_cast<T*>(of_table.get()) = sent;
    expect_arrival(generic->publish(std::move(of_table)));
  });
  EXPECT_GT(count, 10);
}

TEST_F(Copying, AFlatMessageKeepsItsAlignment) {
  auto subscription = create_subscription<Flat>(node, own("flat"), QoS(5));
  auto publisher = create_publisher<Flat>(node, own("flat"), QoS(5));
  auto loan = publisher->borrow_loaned_message();
  loan->number = 5;
  loan->bytes[999] = std::byte{6};
  EXPECT_EQ(publisher->publish(std::move(loan)).adopted_bytes, sizeof(Flat));
  const auto message = take_soon(subscription);
  ASSERT_TRUE(message);
  EXPECT_EQ(reinterpret_cast<std::uintptr_t>(message.get()) % alignof(Flat), 0U);
  EXPECT_EQ(message->number, 5U);
  EXPECT_EQ(message->bytes[999], std::byte{6});
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

TEST_F(Copying, IsRefusedForWhatCannotBeCopiedAndForWhoMustNot) {
  for (int i = 0; i < 2; ++i) {
    const auto unknown = try_create_publisher<Unknown>(node, own("u"), QoS(1));
    ASSERT_FALSE(unknown) << "nothing is known of its memory";
    EXPECT_EQ(unknown.error().code, Errc::hook_missing);
    const auto by_allocator = try_create_publisher<OwnMemory>(node, own("o"), QoS(1));
    ASSERT_FALSE(by_allocator) << "its memory needs the hook";
    EXPECT_EQ(by_allocator.error().code, Errc::hook_missing);
    const auto strict =
        try_create_publisher<Flat>(node, own("f"), QoS(1), PublisherOptions().allow_copy(false));
    ASSERT_FALSE(strict);
    EXPECT_EQ(strict.error().code, Errc::hook_missing);
    EXPECT_TRUE(try_create_publisher<Flat>(node, own("f"), QoS(1)));
    EXPECT_TRUE(try_create_subscription<Unknown>(node, own("u"), QoS(1)));
  }
  SharedVector<int> ordinary(1000, 7);
  EXPECT_EQ(ordinary[999], 7) << "the allocator uses the ordinary heap";
  EXPECT_NE(std::make_unique<OwnMemory>(), nullptr);
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
