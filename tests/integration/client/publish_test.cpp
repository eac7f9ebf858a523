// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever goes wrong at borrow and publish is told by a clear code, the caller keeps the
// message, and the publisher works again afterwards.
// Method: publisher and subscription in this process, the real daemon with one small heap window, the
// real hook. Message types of the test throw when they are told to.

#include <agnocast/abi/heaphook.h>
#include <agnocast/agnocast.hpp>
#include <tests/support/daemon_process.hpp>
#include <tests/support/plain_node.hpp>

#include <gmock/gmock.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <deque>
#include <memory>
#include <new>
#include <stdexcept>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using test::PlainNode;
using test::take_soon;

/// What the next construction of a Moody throws.
enum class Mood { good, bad_alloc, other } constructing = Mood::good, copying = Mood::good;

void act(Mood mood) {
  if (mood == Mood::bad_alloc) throw std::bad_alloc();
  if (mood == Mood::other) throw std::runtime_error("in a bad mood");
}

struct Moody {
  std::vector<std::uint8_t> data;
  Moody() : data(100) { act(constructing); }
  Moody(const Moody& other) : data(other.data) { act(copying); }
  Moody& operator=(const Moody&) = default;
};

}  // namespace

template <>
struct MessageTraits<Moody> {
  static constexpr const char* name = "tests/Moody";
  static void for_each_pointer(const Moody& moody, PointerVisitor& visit) noexcept {
    visit("data", moody.data);
  }
};

namespace {

/// Before and after the daemon has refused another window.
bool is_full(Errc code) { return code == Errc::heap_exhausted || code == Errc::window_exhausted; }

bool allocates_shared() {
  const auto block = std::make_unique<std::vector<int>>(1000);
  return agnocast_heaphook()->owns(block->data()) != 0;
}

class Publishing : public testing::Test {
 protected:
  // The library connects once per process.
  static void SetUpTestSuite() {
    daemon =
        new test::DaemonProcess({.config = "[heap]\nwindow_bytes = \"64MiB\"\n"
                                           "arena_bytes = \"1GiB\"\nwindows_per_process = 1\n"});
    ::setenv("AGNOCAST_SOCKET", daemon->socket_path().c_str(), 1);
  }
  void TearDown() override {
    constructing = copying = Mood::good;
    EXPECT_FALSE(allocates_shared()) << "a scope was left open";
  }
  static test::DaemonProcess* daemon;
  PlainNode node;
};
test::DaemonProcess* Publishing::daemon = nullptr;

bool all_are(const std::vector<std::uint8_t>& data, std::uint8_t value) {
  return std::all_of(data.begin(), data.end(), [&](std::uint8_t byte) { return byte == value; });
}

/// In another thread: outside every loan.
std::unique_ptr<Moody> foreign(std::uint8_t value) {
  std::unique_ptr<Moody> made;
  std::thread([&] {
    made = std::make_unique<Moody>();
    made->data.assign(5000, value);
  }).join();
  return made;
}

TEST_F(Publishing, AConstructorThatThrowsInBorrowIsTheCallers) {
  auto publisher = create_publisher<Moody>(node, "moody", 1);
  constructing = Mood::other;
  EXPECT_THROW(publisher->borrow_loaned_message(), std::runtime_error);
  EXPECT_FALSE(allocates_shared()) << "no loan, no scope";
  constructing = Mood::bad_alloc;
  EXPECT_THROW(publisher->borrow_loaned_message(), std::bad_alloc);
  constructing = Mood::good;
  EXPECT_TRUE(publisher->publish(publisher->borrow_loaned_message()));
}

TEST_F(Publishing, ACopyConstructorThatThrowsInAdoptionLeavesTheMessageWithTheCaller) {
  auto subscription = create_subscription<Moody>(node, "moody", QoS(5));
  auto publisher = create_publisher<Moody>(node, "moody", 1);
  auto message = foreign(1);
  const Moody* const address = message.get();
  copying = Mood::other;
  EXPECT_EQ(publisher->publish(std::move(message)).code, Errc::user_code_threw);
  ASSERT_EQ(message.get(), address);
  EXPECT_TRUE(all_are(message->data, 1));
  copying = Mood::bad_alloc;
  EXPECT_TRUE(is_full(publisher->publish(std::move(message)).code));
  ASSERT_EQ(message.get(), address);

  copying = Mood::other;
  auto loan = publisher->borrow_loaned_message();
  loan->data = std::move(foreign(2)->data);
  EXPECT_EQ(publisher->publish(std::move(loan)).code, Errc::user_code_threw);
  ASSERT_TRUE(loan);
  EXPECT_TRUE(all_are(loan->data, 2));
  EXPECT_TRUE(allocates_shared()) << "it is still a loan";

  copying = Mood::good;
  EXPECT_TRUE(publisher->publish(std::move(message)));
  EXPECT_TRUE(publisher->publish(std::move(loan)));
  EXPECT_TRUE(all_are(take_soon(subscription)->data, 1));
  EXPECT_TRUE(all_are(take_soon(subscription)->data, 2));
}

TEST_F(Publishing, OnlyALoanOfThisPublisherIsPublishedAndOnlyOnce) {
  auto publisher = create_publisher<Moody>(node, "moody", 1);
  auto other = create_publisher<Moody>(node, "other", 1);
  auto loan = publisher->borrow_loaned_message();
  auto moved = std::move(loan);
  EXPECT_EQ(publisher->publish(std::move(loan)).code, Errc::loan_invalid) << "moved from";
  EXPECT_EQ(other->publish(std::move(moved)).code, Errc::loan_invalid) << "another publisher's";
  ASSERT_TRUE(moved);
  auto copy = moved;
  EXPECT_TRUE(publisher->publish(std::move(moved)));
  EXPECT_EQ(publisher->publish(std::move(copy)).code, Errc::loan_invalid) << "published";
  EXPECT_EQ(publisher->publish(ipc_shared_ptr<Moody>()).code, Errc::loan_invalid);
  EXPECT_EQ(publisher->publish(std::unique_ptr<Moody>()).code, Errc::loan_invalid);
  EXPECT_EQ(publisher->publish_for(std::unique_ptr<Moody>(), seconds(60)).code, Errc::loan_invalid)
      << "no use in waiting";
}

TEST_F(Publishing, ALoanOutlivesItsPublisher) {
  auto publisher = create_publisher<Moody>(node, "moody", 1);
  auto loan = publisher->borrow_loaned_message();
  publisher.reset();
  loan->data.resize(10000);
  EXPECT_TRUE(allocates_shared());
  loan.reset();
}

TEST_F(Publishing, KeepAllBlocksAndPublishForWaitsForTheReader) {
  auto subscription = create_subscription<Moody>(node, "all", QoS(1).keep_all(3));
  auto publisher = create_publisher<Moody>(node, "all", QoS(1).keep_all(3));
  ASSERT_TRUE(test::eventually([&] { return publisher->get_subscription_count() == 1; }));
  std::uint8_t number = 0;
  PublishResult result;
  auto message = foreign(number);
  while ((result = publisher->publish(std::move(message)))) {
    ASSERT_LT(number, 100);
    message = foreign(++number);
  }
  EXPECT_EQ(result.code, Errc::would_block);
  EXPECT_EQ(number, 3);
  ASSERT_NE(message, nullptr);

  EXPECT_EQ(publisher->publish_for(std::move(message), seconds(0)).code, Errc::would_block);
  EXPECT_EQ(publisher->publish_for(std::move(message), seconds(-1)).code, Errc::would_block);
  const auto before = std::chrono::steady_clock::now();
  EXPECT_EQ(publisher->publish_for(std::move(message), milliseconds(50)).code, Errc::would_block);
  EXPECT_GE(std::chrono::steady_clock::now() - before, milliseconds(50));
  ASSERT_NE(message, nullptr);

  auto last = foreign(4);
  std::thread reader;
  std::atomic<bool> is_waiting{false};
  reader = std::thread([&] {
    while (!is_waiting) std::this_thread::yield();
    std::this_thread::sleep_for(milliseconds(20));
    for (std::uint8_t i = 0; i < 5; ++i) {
      const auto taken = take_soon(subscription);
      ASSERT_TRUE(taken);
      EXPECT_TRUE(all_are(taken->data, i));
    }
  });
  is_waiting = true;
  EXPECT_TRUE(publisher->publish_for(std::move(message), std::chrono::hours::max()));
  result = publisher->publish_for(std::move(last), seconds(60));
  reader.join();
  EXPECT_TRUE(result) << sentence_of(result.code);
  EXPECT_EQ(result.adopted_bytes, sizeof(Moody) + 5000) << "the attempt that adopted counts";
}

TEST_F(Publishing, AFullHeapIsToldAndForgottenWhenReadersRelease) {
  auto subscription = create_subscription<Moody>(node, "full", QoS(100));
  auto publisher = create_publisher<Moody>(node, "full", 100);
  ASSERT_TRUE(test::eventually([&] { return publisher->get_subscription_count() == 1; }));
  std::deque<ipc_shared_ptr<const Moody>> held;
  ipc_shared_ptr<Moody> loan;
  PublishResult result;
  std::uint8_t number = 0;
  for (;; ++number) {
    ASSERT_LT(number, 64);
    loan = publisher->borrow_loaned_message();
    loan->data.assign(4 << 20, number);
    result = publisher->publish(std::move(loan));
    if (!result) break;
    EXPECT_EQ(result.adopted_bytes, 0u);
    held.push_back(take_soon(subscription));
    ASSERT_TRUE(held.back());
  }
  EXPECT_TRUE(is_full(result.code)) << sentence_of(result.code);
  EXPECT_GE(number, 8) << "64 MiB hold more than that";
  ASSERT_TRUE(loan) << "the caller still has it";
  EXPECT_EQ(agnocast_heaphook()->owns(loan->data.data()), 0) << "its memory came from libc";
  EXPECT_TRUE(all_are(loan->data, number));
  EXPECT_TRUE(test::eventually([&] {
    return publisher->publish(std::move(loan)).code == Errc::window_exhausted;
  })) << "the daemon has refused another window";

  // A smaller one still fits.
  auto small = publisher->borrow_loaned_message();
  EXPECT_TRUE(publisher->publish(std::move(small)));
  EXPECT_EQ(take_soon(subscription)->data.size(), 100u);

  for (std::size_t i = 0; i < held.size(); ++i)
    EXPECT_TRUE(all_are(held[i]->data, static_cast<std::uint8_t>(i)));
  held.clear();
  EXPECT_TRUE(test::eventually([&] {
    result = publisher->publish(std::move(loan));
    return static_cast<bool>(result);
  })) << sentence_of(result.code);
  EXPECT_EQ(result.adopted_bytes, 4u << 20);
  EXPECT_TRUE(all_are(take_soon(subscription)->data, number));
}

}  // namespace
}  // namespace agnocast
