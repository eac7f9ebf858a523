// SPDX-License-Identifier: Apache-2.0
//
// Goal: nodes in C and in C++ publish and take the same messages, as objects, as bytes and as
// loans, and what is not a message is refused without a trace. Method: random messages with every
// kind of member, between endpoints of this process and the real daemon; the equality that rosidl
// generates judges them.

#include <ros2/rmw_agnocast_cpp/core/topics.hpp>

#include <agnocast/agnocast.hpp>
#include <tests/integration/rmw/messages.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gmock/gmock.h>
#include <rosidl_runtime_c/string_functions.h>

#include <array>
#include <cstdint>
#include <memory>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::rmw {
namespace {

using test::eventually;

#ifdef AGNOCAST_TEST_SANITIZED
constexpr bool has_hook = false;
#else
constexpr bool has_hook = true;
#endif

MessageSupport in_c() { return c_support<Everything>(); }
MessageSupport in_cpp() { return cpp_support<Everything>(); }

class RmwTopics : public test::SuiteDaemon {
 protected:
  std::unique_ptr<TopicPublisher> publisher(const MessageSupport& support) {
    return valued(TopicPublisher::create(node, topic, support, QoS(10)));
  }
  std::unique_ptr<TopicSubscription> subscription(const MessageSupport& support) {
    return valued(TopicSubscription::create(node, topic, support, QoS(10), false));
  }
  /// Waits for a message.
  static void take(TopicSubscription& from, void* message) {
    MessageInfo info;
    ASSERT_TRUE(eventually([&] { return from.take(message, info); }));
    EXPECT_NE(info.publish_time_ns, 0u);
  }
  static void expect_nothing(TopicSubscription& from, void* message) {
    MessageInfo info;
    EXPECT_FALSE(from.take(message, info));
  }

  const NodeName node{"node", "/" + own("space")};
  const std::string topic = "/" + own("topic");
};

TEST_F(RmwTopics, NodesInBothLanguagesGetEachMessage) {
  const auto from_c = publisher(in_c()), from_cpp = publisher(in_cpp());
  const auto to_c = subscription(in_c()), to_cpp = subscription(in_cpp());
  auto got_in_c = make_in_c<Everything>();
  Everything got;
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    SCOPED_TRACE(seed);
    const Everything message = random_message<Everything>(seed);
    const auto message_in_c = in_c_of(message);
    for (const bool is_from_c : {true, false}) {
      const PublishResult published =
          is_from_c ? from_c->publish(message_in_c.get()) : from_cpp->publish(&message);
      ASSERT_TRUE(published) << static_cast<int>(published.code);
      take(*to_c, got_in_c.get());
      take(*to_cpp, &got);
      EXPECT_EQ(got, message);
      EXPECT_TRUE(InC<Everything>::are_equal(got_in_c.get(), message_in_c.get()));
    }
  }
  expect_nothing(*to_c, got_in_c.get());
  expect_nothing(*to_cpp, &got);
}

TEST_F(RmwTopics, TypedEndpointsOfThisLibraryTakePart) {
  Node other(own("other"));
  const auto typed_publisher = other.create_publisher<Everything>(topic, 10);
  const auto typed_subscription = other.create_subscription<Everything>(topic, 10);
  const auto from_c = publisher(in_c());
  const auto to_c = subscription(in_c());
  const Everything message = random_message<Everything>(3);
  const auto message_in_c = in_c_of(message);
  auto got_in_c = make_in_c<Everything>();
  ASSERT_TRUE(typed_publisher->publish(message));
  take(*to_c, got_in_c.get());
  EXPECT_TRUE(InC<Everything>::are_equal(got_in_c.get(), message_in_c.get()));
  ASSERT_TRUE(from_c->publish(message_in_c.get()));
  std::size_t count = 0;
  ASSERT_TRUE(eventually([&] {
    while (const auto taken = typed_subscription->take()) {
      EXPECT_EQ(*taken, message);
      ++count;
    }
    return count == 2;
  }));
}

// As in DDS within a process. Under load a link may take longer than a creation waits for it.
TEST_F(RmwTopics, EndpointsOfOneProcessAreLinkedOnceTheyAreThere) {
  constexpr int count = 40;
  int linked = 0;
  for (int i = 0; i < count; ++i) {
    std::unique_ptr<TopicPublisher> from;
    std::unique_ptr<TopicSubscription> to;
    if (i % 2 == 0) from = publisher(in_cpp());
    to = subscription(in_cpp());
    if (i % 2 != 0) from = publisher(in_cpp());
    const bool is_linked = from->endpoint().get_linked_subscription_count() == 1;
    linked += is_linked;
    const Everything message{};
    ASSERT_TRUE(from->publish(&message));
    Everything got;
    MessageInfo info;
    EXPECT_TRUE(to->take(&got, info) || !is_linked) << i;
  }
  EXPECT_GE(linked, count * 3 / 4);
}

TEST_F(RmwTopics, NodesOfAnotherDomainAreOnAnotherTopic) {
  const NodeName elsewhere{"node", node.name_space, 57};
  std::vector<std::unique_ptr<TopicPublisher>> from;
  std::vector<std::unique_ptr<TopicSubscription>> to;
  for (const NodeName& of : {node, elsewhere}) {
    from.push_back(valued(TopicPublisher::create(of, topic, in_cpp(), QoS(10))));
    to.push_back(valued(TopicSubscription::create(of, topic, in_cpp(), QoS(10), false)));
  }
  Graph graph;
  std::multiset<std::uint64_t> domains;
  const auto seen = valued(graph.wait(std::chrono::seconds(60)));
  ASSERT_TRUE(seen);
  for (const EndpointInfo& endpoint : seen->endpoints) {
    if (endpoint.topic == topic) domains.insert(endpoint.domain);
  }
  EXPECT_EQ(domains, (std::multiset<std::uint64_t>{0, 0, 57, 57}));
  for (const std::size_t i : {0u, 1u}) {
    ASSERT_TRUE(
        eventually([&] { return from[i]->endpoint().get_linked_subscription_count() == 1; }));
    EXPECT_EQ(from[i]->endpoint().get_subscription_count(), 1u);
    const auto sent = random_message<Everything>(static_cast<unsigned>(i));
    ASSERT_TRUE(from[i]->publish(&sent));
    Everything got;
    take(*to[i], &got);
    EXPECT_EQ(got, sent);
    expect_nothing(*to[1 - i], &got);
  }
}

TEST_F(RmwTopics, BytesAreMessages) {
  const auto from_c = publisher(in_c());
  const auto to_c = subscription(in_c()), to_cpp = subscription(in_cpp());
  const Everything message = random_message<Everything>(5);
  std::vector<std::byte> bytes(bridge::cdr_bytes(in_cpp().cdr(), &message));
  ASSERT_TRUE(bridge::write_cdr(in_cpp().cdr(), &message, bytes));
  ASSERT_TRUE(from_c->publish_serialized(bytes));
  Everything got;
  take(*to_cpp, &got);
  EXPECT_EQ(got, message);
  std::vector<std::byte> got_bytes;
  MessageInfo info;
  ASSERT_TRUE(eventually([&] { return to_c->take_serialized(got_bytes, info); }));
  EXPECT_EQ(got_bytes, bytes);
  // Whatever is missing at its end, it is none.
  for (const std::size_t length : {std::size_t{0}, std::size_t{3}, bytes.size() / 2}) {
    const PublishResult refused = from_c->publish_serialized(std::span(bytes).first(length));
    EXPECT_EQ(refused.code, Errc::invalid_argument) << length;
  }
  expect_nothing(*to_cpp, &got);
}

TEST_F(RmwTopics, AMessageThatIsTooLongForItsTypeIsNotPublished) {
  const auto from_c = publisher(in_c());
  const auto to_cpp = subscription(in_cpp());
  auto message = make_in_c<Everything>();
  ASSERT_TRUE(
      rosidl_runtime_c__String__assign(&message->bounded_text, std::string(41, 'x').c_str()));
  EXPECT_EQ(from_c->publish(message.get()).code, Errc::invalid_argument);
  ASSERT_TRUE(rosidl_runtime_c__String__assign(&message->bounded_text, "short"));
  ASSERT_TRUE(from_c->publish(message.get()));
  Everything got;
  take(*to_cpp, &got);
  EXPECT_EQ(got.bounded_text, "short");
  expect_nothing(*to_cpp, &got);
}

TEST_F(RmwTopics, LoansArriveAsTheyAre) {
  const auto from = publisher(in_cpp());
  const auto to = subscription(in_cpp()), copied = subscription(in_cpp());
  ASSERT_TRUE(from->can_lend() && to->can_lend());
  EXPECT_FALSE(publisher(in_c())->can_lend());
  const auto is_layout_of = [&](const rosidl_message_type_support_t* handle) {
    return from->support().is_layout_of(*handle);
  };
  EXPECT_TRUE(is_layout_of(cpp_handle<Everything>()));
  EXPECT_FALSE(is_layout_of(cpp_handle<Forest>()));
  EXPECT_FALSE(is_layout_of(InC<Everything>::handle()));
  auto* const loan = static_cast<Everything*>(from->borrow());
  const Everything message = random_message<Everything>(7);
  *loan = message;
  const PublishResult published = from->publish_loaned(loan);
  ASSERT_TRUE(published);
  if (has_hook) EXPECT_EQ(published.adopted_bytes, 0u);
  MessageInfo info;
  const void* taken = nullptr;
  ASSERT_TRUE(eventually([&] { return (taken = to->take_loaned(info)) != nullptr; }));
  if (has_hook) EXPECT_EQ(taken, loan) << "nothing was copied";
  EXPECT_EQ(*static_cast<const Everything*>(taken), message);
  Everything got;
  take(*copied, &got);
  EXPECT_EQ(got, message);
  EXPECT_TRUE(to->give_back(taken));
  EXPECT_FALSE(to->give_back(taken)) << "given back already";
  EXPECT_EQ(to->take_loaned(info), nullptr);
}

TEST_F(RmwTopics, AKeepAllSubscriptionHoldsUpItsPublishersForAMoment) {
  const QoS keeps_all = QoS(2).keep_all(2);
  const auto from = valued(TopicPublisher::create(node, topic, in_cpp(), keeps_all));
  const auto from_c = valued(TopicPublisher::create(node, topic, in_c(), keeps_all));
  const auto to = valued(TopicSubscription::create(node, topic, in_cpp(), keeps_all, false));
  const Everything message;
  const auto message_in_c = in_c_of(message);
  // One more than the bound, because the publisher may commit one before it knows the subscription.
  const auto publish_until_full = [](const auto& publish) {
    Errc code = Errc::ok;
    for (int i = 0; i < 5 && code == Errc::ok; ++i) code = publish().code;
    return code;
  };
  EXPECT_EQ(publish_until_full([&] { return from->publish(&message); }), Errc::would_block);
  EXPECT_EQ(publish_until_full([&] { return from_c->publish(message_in_c.get()); }),
            Errc::would_block);
  EXPECT_EQ(publish_until_full([&] { return from->publish_loaned(from->borrow()); }),
            Errc::would_block);
  Everything got;
  take(*to, &got);
  EXPECT_EQ(from->publish(&message).code, Errc::ok);
}

TEST_F(RmwTopics, LoansThatAreNotPublishedEnd) {
  const auto from = publisher(in_cpp());
  void* const first = from->borrow();
  void* const second = from->borrow();
  EXPECT_NE(first, second);
  EXPECT_TRUE(from->give_back(first));
  EXPECT_FALSE(from->give_back(first));
  EXPECT_EQ(from->publish_loaned(first).code, Errc::loan_invalid);
  int no_loan = 0;
  EXPECT_EQ(from->publish_loaned(&no_loan).code, Errc::loan_invalid);
  // The second one ends with its publisher.
}

TEST_F(RmwTopics, MessagesWakeAWaitSet) {
  const auto from = publisher(in_c());
  const auto to = subscription(in_cpp()), idle = subscription(in_c());
  WaitPool pool;
  WaitSet set(pool);
  Everything got;
  auto got_in_c = make_in_c<Everything>();
  EXPECT_FALSE(set.wait({}, {to.get()}, WaitSet::Duration::zero()).value());
  ASSERT_TRUE(from->publish(in_c_of(random_message<Everything>(9)).get()));
  ASSERT_TRUE(set.wait({}, {to.get()}, std::nullopt).value());
  EXPECT_TRUE(set.is_readable_ready(0));
  take(*to, &got);
  EXPECT_EQ(got, random_message<Everything>(9));
  ASSERT_TRUE(set.wait({}, {to.get(), idle.get()}, std::nullopt).value());
  EXPECT_FALSE(set.is_readable_ready(0));
  EXPECT_TRUE(set.is_readable_ready(1));
}

TEST(RmwSupport, HandlesWithoutWhatIsNeededAreRefused) {
  EXPECT_EQ(MessageSupport::of(nullptr).error().code, Errc::invalid_argument);
  rosidl_message_type_support_t other{};
  other.func = [](const rosidl_message_type_support_t*,
                  const char*) -> const rosidl_message_type_support_t* { return nullptr; };
  EXPECT_EQ(MessageSupport::of(&other).error().code, Errc::type_refused);
  // In C, of a package that is not here in C++.
  CMembers unknown = *static_cast<const CMembers*>(InC<Everything>::handle()->data);
  unknown.message_namespace_ = "no_such_package__msg";
  rosidl_message_type_support_t lonely = *InC<Everything>::handle();
  lonely.data = &unknown;
  const auto refused = MessageSupport::of(&lonely);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::type_not_found) << text_of(refused.error());
}

}  // namespace
}  // namespace agnocast::rmw
