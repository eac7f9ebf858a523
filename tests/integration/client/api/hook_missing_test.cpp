// SPDX-License-Identifier: Apache-2.0
//
// Goal: without the heap hook a flat message is copied, with its alignment; what cannot be copied,
// or must not be, is refused. Method: this program has no hook and no rosidl message;
// heap/copying_test.cpp has those.

#include <agnocast/agnocast.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

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

class HookMissing : public test::SuiteDaemon {
 protected:
  test::PlainNode node;
};

TEST_F(HookMissing, AFlatMessageIsCopiedWithItsAlignment) {
  auto subscription = create_subscription<Flat>(node, own("flat"), QoS(5));
  auto publisher = create_publisher<Flat>(node, own("flat"), QoS(5));
  auto loan = publisher->borrow_loaned_message();
  loan->number = 5;
  loan->bytes[999] = std::byte{6};
  EXPECT_EQ(publisher->publish(std::move(loan)).adopted_bytes, sizeof(Flat));
  const auto message = test::take_soon(subscription);
  ASSERT_TRUE(message);
  EXPECT_EQ(reinterpret_cast<std::uintptr_t>(message.get()) % alignof(Flat), 0U);
  EXPECT_EQ(message->number, 5U);
  EXPECT_EQ(message->bytes[999], std::byte{6});
}

TEST_F(HookMissing, IsReportedForWhatCannotBeCopiedAndForWhoMustNot) {
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

}  // namespace
}  // namespace agnocast
