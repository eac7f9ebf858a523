// SPDX-License-Identifier: Apache-2.0
//
// Goal: generic endpoints match typed ones of the same type, in both directions and without a
// copy, and are refused in the same cases; their messages are freed in the same way.
// Method: both in this process, the real daemon, the real hook; every message type of interfaces/
// with random values, compared by the table, and where typed endpoints exist by the types' own
// operator==. Under sanitizers, which bring another malloc, only the parts that need no publisher
// of rosidl messages.

#include <agnocast/abi/heaphook.h>
#include <agnocast/executor.hpp>
#include <agnocast/generic.hpp>
#include <agnocast/heap.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gmock/gmock.h>

#ifndef AGNOCAST_TEST_SANITIZED
#include <every_kind_of_message.hpp>
#include <every_message_name.hpp>
#include <tests/support/messages/random_message.hpp>
#endif
#include <std_msgs/msg/header.hpp>
#include <std_msgs/msg/string.hpp>

#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <string>
#include <thread>
#include <utility>

namespace agnocast {
namespace {

using test::PlainNode;
using test::take_soon;

/// Claims to be a std_msgs/msg/String, and is not.
struct Impostor {
  std::uint64_t number = 0;
};
struct Track : SharedMessage {
  std::uint32_t id = 0;
  SharedString label;
};

}  // namespace

template <>
struct MessageTraits<Impostor> {
  static constexpr const char* name = "std_msgs/msg/String";
};
template <>
struct MessageTraits<Track> {
  static constexpr const char* name = "tests/Track";
  static void for_each_pointer(const Track& track, PointerVisitor& visit) noexcept {
    visit("label", track.label);
  }
};

namespace {

class Generic : public test::SuiteDaemon {
 protected:
  static void SetUpTestSuite() {
    start({.config =
               "[heap]\n" AGNOCAST_TEST_ARENA_BASE
               "window_bytes = \"64MiB\"\narena_bytes = \"1GiB\"\nwindows_per_process = 1\n"});
  }
  PlainNode node;
};

TEST_F(Generic, ASubscriptionThatKnowsOnlyTheIdentityGetsTheMessages) {
  const auto type = message_type_of<Track>();
  auto subscription = create_generic_subscription(node, "tracks", type->identity(), QoS(5));
  auto publisher = create_publisher<Track>(node, "tracks", 5);
  auto loan = publisher->borrow_loaned_message();
  loan->id = 7;
  loan->label = "a label that does not fit into a string object";
  ASSERT_TRUE(publisher->publish(std::move(loan)));
  const GenericMessage message = take_soon(subscription);
  ASSERT_TRUE(message);
  EXPECT_EQ(message.members(), nullptr);
  EXPECT_EQ(subscription->members(), nullptr);
  EXPECT_EQ(message.info().object_bytes, sizeof(Track));
  EXPECT_EQ(static_cast<const Track*>(message.get())->label,
            "a label that does not fit into a string object");
  const auto other = try_create_generic_subscription(
      node, "tracks", TypeIdentity{type->name(), type->layout_hash() + 1}, QoS(5));
  ASSERT_FALSE(other);
  EXPECT_EQ(other.error().code, Errc::type_mismatch);
}

TEST_F(Generic, AnotherLayoutOfTheSameNameIsRefused) {
  const auto typed = try_create_subscription<Impostor>(node, "impostor", QoS(1));
  ASSERT_TRUE(typed);
  const auto generic = try_create_generic_subscription(node, "impostor", "std_msgs/msg/String", 1);
  ASSERT_FALSE(generic);
  EXPECT_EQ(generic.error().code, Errc::type_mismatch);
  EXPECT_THAT(text_of(generic.error()), testing::HasSubstr("std_msgs/msg/String"));
}

TEST_F(Generic, InvalidNamesAndUnknownTypesAreRefused) {
  EXPECT_EQ(try_create_generic_subscription(node, "x", "std_msgs/msg/Nothing", 1).error().code,
            Errc::type_not_found);
  EXPECT_EQ(try_create_generic_publisher(node, "x", "nowhere_msgs/msg/Nothing", 1).error().code,
            Errc::type_not_found);
  EXPECT_EQ(try_create_generic_publisher(node, "x", "/etc/passwd", 1).error().code,
            Errc::invalid_name);
  EXPECT_EQ(try_create_generic_subscription(node, "no topic", "std_msgs/String", 1).error().code,
            Errc::invalid_name);
  EXPECT_THROW(create_generic_publisher(node, "x", "std_msgs/msg/Nothing", QoS(1)), Error);
  EXPECT_THROW(create_generic_subscription(node, "x", "std_msgs/msg/Nothing", QoS(1)), Error);
}

#ifndef AGNOCAST_TEST_SANITIZED

bool is_shared(const void* memory) { return agnocast_heaphook()->owns(memory) != 0; }

TEST_F(Generic, EveryKindOfTypeGoesFromTypedToGenericAndBack) {
  test::RandomMessages random(11, {.has_nan = false, .has_any_text = true});
  int count = 0;
  test::for_every_kind_of_message([&](auto* null, const std::string& name) {
    using T = std::remove_pointer_t<decltype(null)>;
    const std::string topic = "every/t" + std::to_string(count++);
    const MessageMembers& members = find_message_type(name).members();
    auto typed_subscription = create_subscription<T>(node, topic, QoS(5));
    auto generic_subscription = create_generic_subscription(node, topic, name, QoS(5));
    auto typed = create_publisher<T>(node, topic, QoS(5));
    auto generic = create_generic_publisher(node, topic, name, QoS(5));
    T sent;
    random.fill(members, &sent);
    {
      auto loan = typed->borrow_loaned_message();
      *loan = sent;
      ASSERT_TRUE(typed->publish(std::move(loan)));
    }
    const GenericMessage got = take_soon(generic_subscription);
    ASSERT_TRUE(got) << name;
    EXPECT_EQ(got.members(), &members);
    EXPECT_EQ(*static_cast<const T*>(got.get()), sent) << name;
    const auto same = take_soon(typed_subscription);
    EXPECT_EQ(got.get(), same.get()) << name << ": both read the same memory";

    GenericLoan loan = generic->borrow_loaned_message();
    ASSERT_TRUE(loan);
    EXPECT_EQ(*static_cast<const T*>(loan.get()), T()) << name << ": with its defaults";
    IntrospectedType(*loan.members()).assign(&sent, loan.get());
    const void* const address = loan.get();
    const PublishResult result = generic->publish(std::move(loan));
    EXPECT_TRUE(result) << name;
    EXPECT_EQ(result.adopted_bytes, 0U) << name;
    EXPECT_FALSE(loan);
    const auto back = take_soon(typed_subscription);
    ASSERT_TRUE(back) << name;
    EXPECT_EQ(*back, sent) << name;
    EXPECT_EQ(back.get(), address) << name;
  });
  EXPECT_GE(count, 40);
}

TEST_F(Generic, ForeignMemoryIsAdoptedWithTheSameCountAsTyped) {
  test::RandomMessages random(12, {.has_nan = false, .has_any_text = false});
  int count = 0;
  test::for_every_kind_of_message([&](auto* null, const std::string& name) {
    using T = std::remove_pointer_t<decltype(null)>;
    const std::string topic = "adopted/t" + std::to_string(count++);
    const IntrospectedType type = find_message_type(name);
    auto subscription = create_subscription<T>(node, topic, QoS(5));
    auto typed = create_publisher<T>(node, topic, QoS(5));
    auto generic = create_generic_publisher(node, topic, type, QoS(5));
    T sent;
    random.fill(type.members(), &sent);
    // Both are copies: a short string in the memory of a longer default is copied into the object.
    auto original = std::make_unique<T>(sent);
    OwnedGenericMessage same = type.copy(&sent);
    EXPECT_FALSE(is_shared(same.get()));
    const PublishResult of_typed = typed->publish(std::move(original));
    const PublishResult of_generic = generic->publish(std::move(same));
    EXPECT_TRUE(of_generic) << name;
    EXPECT_EQ(same, nullptr);
    EXPECT_GE(of_generic.adopted_bytes, sizeof(T)) << name;
    EXPECT_EQ(of_generic.adopted_bytes, of_typed.adopted_bytes) << name;
    for (int i = 0; i < 2; ++i) {
      const auto got = take_soon(subscription);
      ASSERT_TRUE(got) << name;
      EXPECT_TRUE(is_shared(got.get()));
      EXPECT_EQ(*got, sent) << name;
    }
  });
}

TEST_F(Generic, EveryTypeWorksByItsNameLoanedAndAdopted) {
  test::RandomMessages random(13, {.has_nan = true, .has_any_text = true});
  int count = 0;
  for (const char* const name : test::every_message_name) {
    const std::string topic = "named/t" + std::to_string(count++);
    const IntrospectedType type = find_message_type(name);
    const MessageMembers& members = type.members();
    auto subscription = create_generic_subscription(node, topic, name, QoS(5));
    auto publisher = create_generic_publisher(node, topic, name, QoS(5));
    const OwnedGenericMessage fresh = type.make(), sent = type.make();
    random.fill(members, sent.get());
    GenericLoan loan = publisher->borrow_loaned_message();
    ASSERT_TRUE(loan);
    EXPECT_TRUE(test::are_same(members, loan.get(), fresh.get())) << name << ": with its defaults";
    type.assign(sent.get(), loan.get());
    const void* const address = loan.get();
    const PublishResult lent = publisher->publish(std::move(loan));
    EXPECT_TRUE(lent) << name;
    EXPECT_EQ(lent.adopted_bytes, 0U) << name;
    const GenericMessage first = take_soon(subscription);
    ASSERT_TRUE(first) << name;
    EXPECT_EQ(first.get(), address) << name;
    EXPECT_EQ(first.members(), &members);
    EXPECT_TRUE(test::are_same(members, first.get(), sent.get())) << name;

    const PublishResult adopted = publisher->publish(type.copy(sent.get()));
    EXPECT_TRUE(adopted) << name;
    EXPECT_GE(adopted.adopted_bytes, members.size_of_) << name;
    const GenericMessage second = take_soon(subscription);
    ASSERT_TRUE(second) << name;
    EXPECT_TRUE(is_shared(second.get())) << name;
    EXPECT_TRUE(test::are_same(members, second.get(), sent.get())) << name;
  }
}

TEST_F(Generic, PublishedAndDroppedMessagesReturnTheirMemory) {
  // The heap has 64 MiB; each message takes one.
  const MessageMembers& members = find_message_type("std_msgs/msg/String").members();
  auto publisher = create_generic_publisher(node, "returns", "std_msgs/String", QoS(1));
  const auto fill = [&](GenericLoan& loan) {
    ASSERT_EQ(loan.members(), &members);
    static_cast<std_msgs::msg::String*>(loan.get())->data.assign(1 << 20, 'x');
  };
  for (int i = 0; i < 500; ++i) {
    GenericLoan loan = publisher->borrow_loaned_message();
    fill(loan);
    ASSERT_TRUE(is_shared(static_cast<std_msgs::msg::String*>(loan.get())->data.data())) << i;
    if (i % 3 != 0) {
      ASSERT_TRUE(publisher->publish(std::move(loan))) << i;
    }
  }
  GenericLoan paused = publisher->borrow_loaned_message();
  EXPECT_TRUE(publisher->pause(paused.handle()));
  EXPECT_FALSE(is_shared(std::make_unique<std::string>(100, 'x')->data()));
  {
    const LoanScope scope(paused.handle());
    fill(paused);
  }
  EXPECT_EQ(publisher->publish(std::move(paused)).adopted_bytes, 0U);
  EXPECT_EQ(publisher->publish(std::move(paused)).code, Errc::loan_invalid);
  EXPECT_EQ(publisher->publish(OwnedGenericMessage()).code, Errc::loan_invalid);
  auto other = create_generic_publisher(node, "returns", "std_msgs/String", QoS(1));
  EXPECT_EQ(other->publish(publisher->borrow_loaned_message()).code, Errc::loan_invalid);
}

TEST_F(Generic, AMessageOutlivesItsEndpoints) {
  auto subscription = create_generic_subscription(node, "outlives", "std_msgs/Header", QoS(1));
  auto publisher = create_generic_publisher(node, "outlives", "std_msgs/Header", QoS(1));
  GenericLoan loan = publisher->borrow_loaned_message();
  static_cast<std_msgs::msg::Header*>(loan.get())->frame_id = std::string(100, 'f');
  ASSERT_TRUE(publisher->publish(std::move(loan)));
  const GenericMessage message = take_soon(subscription);
  publisher.reset();
  subscription.reset();
  ASSERT_TRUE(message);
  EXPECT_EQ(static_cast<const std_msgs::msg::Header*>(message.get())->frame_id,
            std::string(100, 'f'));
}

// All readers use the publisher's type, so a loan of another type must not pass.
TEST_F(Generic, ALoanThatOutlivesItsPublisherIsRefusedByOtherTypes) {
  auto subscription = create_generic_subscription(node, "headers", "std_msgs/Header", QoS(1));
  std::vector<GenericLoan> strings;
  for (int round = 0; round < 50; ++round) {
    {
      auto publisher = create_generic_publisher(node, "strings", "std_msgs/String", QoS(1));
      strings.push_back(publisher->borrow_loaned_message());
      EXPECT_TRUE(publisher->pause(strings.back().handle()));
    }
    auto publisher = create_generic_publisher(node, "headers", "std_msgs/Header", QoS(1));
    for (GenericLoan& loan : strings) {
      ASSERT_EQ(publisher->publish(std::move(loan)).code, Errc::loan_invalid) << round;
      ASSERT_TRUE(loan) << "the caller still has it";
    }
  }
  EXPECT_FALSE(subscription->take());
}

TEST_F(Generic, MessagesOfABatchHaveTheirTable) {
  auto subscription = create_generic_subscription(node, "batch", "std_msgs/Header", QoS(5));
  auto publisher = create_publisher<std_msgs::msg::Header>(node, "batch", 5);
  ASSERT_TRUE(test::eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  for (std::int32_t i = 1; i <= 3; ++i) {
    auto loan = publisher->borrow_loaned_message();
    loan->stamp.sec = i;
    ASSERT_TRUE(publisher->publish(std::move(loan)));
  }
  GenericMessage messages[4];
  ASSERT_EQ(subscription->take_batch(messages, 4), 3u);
  for (std::int32_t i = 1; i <= 3; ++i) {
    const GenericMessage& message = messages[i - 1];
    EXPECT_EQ(static_cast<const std_msgs::msg::Header*>(message.get())->stamp.sec, i);
    EXPECT_EQ(message.info().sequence, static_cast<std::uint64_t>(i));
    EXPECT_EQ(message.members(), subscription->members());
  }
  EXPECT_FALSE(messages[3]);
  EXPECT_EQ(subscription->take_batch(messages, 4), 0u);
  EXPECT_FALSE(messages[0]);
}

TEST_F(Generic, ACallbackIsCalledForEachMessage) {
  std::atomic<std::uint64_t> sum{0};
  BackgroundExecutor executor;
  executor.add_node(node);
  auto subscription = create_generic_subscription(
      node, "called", "std_msgs/UInt64", QoS(100), [&](GenericMessage message) {
        EXPECT_EQ(message.members()->member_count_, 1U);
        sum += *static_cast<const std::uint64_t*>(message.get());
      });
  auto publisher = create_generic_publisher(node, "called", "std_msgs/UInt64", QoS(100));
  for (std::uint64_t i = 1; i <= 50; ++i) {
    GenericLoan loan = publisher->borrow_loaned_message();
    *static_cast<std::uint64_t*>(loan.get()) = i;
    ASSERT_TRUE(publisher->publish(std::move(loan)));
  }
  EXPECT_TRUE(test::eventually([&] { return sum == 50 * 51 / 2; })) << sum;
}

#endif

}  // namespace
}  // namespace agnocast
