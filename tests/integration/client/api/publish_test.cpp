// SPDX-License-Identifier: Apache-2.0
//
// Goal: every failure of borrow and publish has a clear code, the caller keeps the message, and
// the publisher works again afterwards.
// Method: publisher and subscription in this process, the real daemon with one small heap window,
// the real hook. Message types of the test throw on request.

#include <agnocast/abi/heaphook.h>
#include <agnocast/agnocast.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gmock/gmock.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstddef>
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

int parts_copied = 0;
struct Part {
  std::vector<std::uint8_t> bytes;
  explicit Part(std::size_t size) : bytes(size) {}
  Part(const Part& other) : bytes((++parts_copied, other.bytes)) {}
  Part& operator=(const Part&) = default;
};
struct Parts {
  std::vector<Part> parts;
};

}  // namespace

template <>
struct MessageTraits<Parts> {
  static constexpr const char* name = "tests/Parts";
  static void for_each_pointer(const Parts& all, PointerVisitor& visit) noexcept {
    visit("parts", all.parts);
    for (const Part& part : all.parts) visit("parts[]", part.bytes);
  }
};

namespace {

/// Full, before or after the daemon has refused another window.
bool is_full(Errc code) { return code == Errc::heap_exhausted || code == Errc::window_exhausted; }

bool allocates_shared() {
  const auto block = std::make_unique<std::vector<int>>(1000);
  return agnocast_heaphook()->owns(block->data()) != 0;
}

class Publishing : public test::SuiteDaemon {
 protected:
  static void SetUpTestSuite() {
    start({.config = "[heap]\nwindow_bytes = \"64MiB\"\n"
                     "arena_bytes = \"1GiB\"\nwindows_per_process = 1\n"});
  }
  void TearDown() override {
    constructing = copying = Mood::good;
    EXPECT_FALSE(allocates_shared()) << "a scope was left open";
  }
  PlainNode node;
};

bool all_are(const std::vector<std::uint8_t>& data, std::uint8_t value) {
  return std::all_of(data.begin(), data.end(), [&](std::uint8_t byte) { return byte == value; });
}

/// Made in another thread: outside every loan.
std::unique_ptr<Moody> foreign(std::uint8_t value) {
  std::unique_ptr<Moody> made;
  std::thread([&] {
    made = std::make_unique<Moody>();
    made->data.assign(5000, value);
  }).join();
  return made;
}

TEST_F(Publishing, ACallerOfBorrowGetsTheExceptionOfAConstructor) {
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
  EXPECT_EQ(publisher->publish(std::move(loan)).code, Errc::loan_invalid) << "it was moved from";
  EXPECT_EQ(other->publish(std::move(moved)).code, Errc::loan_invalid)
      << "it belongs to another publisher";
  ASSERT_TRUE(moved);
  auto copy = moved;
  EXPECT_TRUE(publisher->publish(std::move(moved)));
  EXPECT_EQ(publisher->publish(std::move(copy)).code, Errc::loan_invalid)
      << "it is already published";
  EXPECT_EQ(publisher->publish(ipc_shared_ptr<Moody>()).code, Errc::loan_invalid);
  EXPECT_EQ(publisher->publish(std::unique_ptr<Moody>()).code, Errc::loan_invalid);
  EXPECT_EQ(publisher->publish_for(std::unique_ptr<Moody>(), seconds(60)).code, Errc::loan_invalid)
      << "waiting would not help";
}

TEST_F(Publishing, ALoanOutlivesItsPublisher) {
  auto publisher = create_publisher<Moody>(node, "moody", 1);
  auto loan = publisher->borrow_loaned_message();
  publisher.reset();
  loan->data.resize(10000);
  EXPECT_TRUE(allocates_shared());
  loan.reset();
}

// Another publisher is made in place of the previous one, usually at the same address.
TEST_F(Publishing, ALoanThatOutlivesItsPublisherBelongsToNoOther) {
  std::vector<ipc_shared_ptr<Moody>> loans;
  for (int round = 0; round < 50; ++round) {
    auto publisher = create_publisher<Moody>(node, "moody", 1);
    for (auto& loan : loans) {
      ASSERT_EQ(publisher->publish(std::move(loan)).code, Errc::loan_invalid) << round;
      ASSERT_FALSE(publisher->pause(loan));
      ASSERT_TRUE(loan) << "the caller still has it";
    }
    loans.push_back(publisher->borrow_loaned_message());
    EXPECT_TRUE(publisher->pause(loans.back()));
  }
}

// As rclcpp's nodes do it: the caller keeps its message, and publish copies it.
TEST_F(Publishing, AMessageOfTheCallerIsCopiedOnceAndStaysTheCallers) {
  auto subscription = create_subscription<Parts>(node, "copy", QoS(5));
  auto publisher = create_publisher<Parts>(node, "copy", 5);
  ASSERT_TRUE(test::eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  Parts parts;
  parts.parts.assign(3, Part(1000));
  parts_copied = 0;
  const PublishResult first = publisher->publish(parts);
  EXPECT_TRUE(first) << sentence_of(first.code);
  EXPECT_EQ(parts_copied, 3);
  EXPECT_EQ(first.adopted_bytes, sizeof(Parts) + 3 * (sizeof(Part) + 1000)) << "the whole message";
  ASSERT_EQ(parts.parts.size(), 3u);
  parts.parts[0].bytes[0] = 1;
  const Parts& constant = parts;
  EXPECT_TRUE(publisher->try_publish(constant));
  EXPECT_TRUE(publisher->publish_for(parts, seconds(1)));
  EXPECT_TRUE(publisher->publish(Parts(parts)));
  for (int i = 0; i < 4; ++i) {
    const auto taken = take_soon(subscription);
    ASSERT_TRUE(taken);
    ASSERT_EQ(taken->parts.size(), 3u);
    EXPECT_EQ(taken->parts[0].bytes[0], i == 0 ? 0 : 1) << i;
    EXPECT_NE(agnocast_heaphook()->owns(taken->parts[2].bytes.data()), 0);
  }
  // publish copies the same way while a loan of the thread is open, and during a pause.
  auto loan = publisher->borrow_loaned_message();
  const LoanPause pause;
  EXPECT_EQ(publisher->publish(parts).adopted_bytes, first.adopted_bytes);
  ASSERT_TRUE(take_soon(subscription));

  Parts large;
  large.parts.assign(1, Part(100 << 20));
  const PublishResult refused = publisher->publish(large);
  EXPECT_TRUE(is_full(refused.code)) << sentence_of(refused.code);
  EXPECT_EQ(refused.adopted_bytes, 0u);
  Moody moody;
  copying = Mood::other;
  EXPECT_EQ(create_publisher<Moody>(node, "moody", 1)->publish(moody).code, Errc::user_code_threw);
}

TEST_F(Publishing, ACopyWaitsForAKeepAllReaderLikeAMessage) {
  auto subscription = create_subscription<Parts>(node, "copies", QoS(1).keep_all(1));
  auto publisher = create_publisher<Parts>(node, "copies", QoS(1).keep_all(1));
  ASSERT_TRUE(test::eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  Parts parts;
  parts.parts.assign(1, Part(1000));
  while (publisher->publish(parts)) ASSERT_LT(parts_copied, 1000);
  parts_copied = 0;
  EXPECT_EQ(publisher->publish_for(parts, milliseconds(50)).code, Errc::would_block);
  EXPECT_EQ(parts_copied, 1) << "one copy for all attempts";
  ASSERT_TRUE(take_soon(subscription));
  EXPECT_TRUE(publisher->publish_for(parts, seconds(60)));
}

TEST_F(Publishing, KeepAllBlocksAndPublishForWaitsForTheReader) {
  auto subscription = create_subscription<Moody>(node, "all", QoS(1).keep_all(3));
  auto publisher = create_publisher<Moody>(node, "all", QoS(1).keep_all(3));
  ASSERT_TRUE(test::eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
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

TEST_F(Publishing, WaitsUntilEachReliableReaderHasTakenAll) {
  auto publisher = create_publisher<Moody>(node, "acked", QoS(10));
  const auto publish = [&](int count) {
    while (count-- > 0) EXPECT_TRUE(publisher->publish(foreign(1)));
  };
  publish(1);
  EXPECT_TRUE(publisher->wait_for_all_acked()) << "nobody has to receive it";
  auto slow = create_subscription<Moody>(node, "acked", QoS(2));
  auto lossy = create_subscription<Moody>(node, "acked", QoS(10).best_effort());
  ASSERT_TRUE(test::eventually([&] { return publisher->get_linked_subscription_count() == 2; }));
  publish(3);
  EXPECT_FALSE(publisher->wait_for_all_acked(seconds(0)));
  ASSERT_TRUE(take_soon(slow));
  EXPECT_FALSE(publisher->wait_for_all_acked(milliseconds(20)));
  ASSERT_TRUE(take_soon(slow));
  EXPECT_TRUE(publisher->wait_for_all_acked()) << "one is lost to it, and the other is best effort";

  publish(2);
  std::atomic<bool> is_waiting{false};
  std::thread reader([&] {
    while (!is_waiting) std::this_thread::yield();
    std::this_thread::sleep_for(milliseconds(20));
    for (int i = 0; i < 2; ++i) EXPECT_TRUE(take_soon(slow));
  });
  is_waiting = true;
  EXPECT_TRUE(publisher->wait_for_all_acked());
  EXPECT_FALSE(slow->take()) << "it has taken both";
  reader.join();

  publish(1);
  EXPECT_FALSE(publisher->wait_for_all_acked(milliseconds(1)));
  slow.reset();
  EXPECT_TRUE(publisher->wait_for_all_acked(std::chrono::minutes(5))) << "nobody can take it";
}

TEST_F(Publishing, AFullHeapIsReportedUntilReadersRelease) {
  auto subscription = create_subscription<Moody>(node, "full", QoS(100));
  auto publisher = create_publisher<Moody>(node, "full", 100);
  ASSERT_TRUE(test::eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
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
  result = publisher->publish(std::move(loan));
  EXPECT_TRUE(result) << sentence_of(result.code)
                      << ": memory that readers release is available at once";
  EXPECT_EQ(result.adopted_bytes, 4u << 20);
  EXPECT_TRUE(all_are(take_soon(subscription)->data, number));
}

/// Fills the heap. Returns the published messages, which it holds.
std::deque<ipc_shared_ptr<const Moody>> fill_heap(const Publisher<Moody>::SharedPtr& publisher,
                                                  const Subscription<Moody>::SharedPtr& reader) {
  EXPECT_TRUE(test::eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  std::deque<ipc_shared_ptr<const Moody>> held;
  for (;;) {
    auto loan = publisher->borrow_loaned_message();
    loan->data.resize(4 << 20);
    if (const PublishResult result = publisher->publish(std::move(loan)); !result) {
      EXPECT_TRUE(is_full(result.code)) << sentence_of(result.code);
      return held;
    }
    held.push_back(take_soon(reader));
  }
}

TEST_F(Publishing, ABorrowAfterAFullHeapFindsReleasedMessages) {
  auto subscription = create_subscription<Moody>(node, "borrow", QoS(100));
  auto publisher = create_publisher<Moody>(node, "borrow", 100);
  for (int round = 0; round < 10; ++round) {
    auto held = fill_heap(publisher, subscription);
    ASSERT_GE(held.size(), 8u) << round;
    held.clear();
    auto loan = publisher->borrow_loaned_message();
    loan->data.resize(4 << 20);
    const PublishResult result = publisher->publish(std::move(loan));
    ASSERT_TRUE(result) << sentence_of(result.code) << " in round " << round;
    EXPECT_EQ(result.adopted_bytes, 0u) << round;
    EXPECT_TRUE(take_soon(subscription));
  }
}

// The heap belongs to the process: an idle publisher may have the memory that another one needs.
TEST_F(Publishing, AFullHeapReclaimsOldMessagesOfOtherPublishers) {
  auto subscription = create_subscription<Moody>(node, "idle", QoS(100));
  auto publisher = create_publisher<Moody>(node, "idle", 100);
  auto other = create_publisher<Moody>(node, "busy", 1);
  for (int round = 0; round < 10; ++round) {
    auto held = fill_heap(publisher, subscription);
    ASSERT_GE(held.size(), 8u) << round;
    auto message = foreign(7);
    message->data.resize(8 << 20);
    EXPECT_TRUE(is_full(other->publish(std::move(message)).code));
    ASSERT_TRUE(message) << "the caller still has it";
    held.clear();
    const PublishResult result = other->publish(std::move(message));
    ASSERT_TRUE(result) << sentence_of(result.code) << " in round " << round;
    EXPECT_EQ(result.adopted_bytes, sizeof(Moody) + (8u << 20));
  }
}

TEST_F(Publishing, AMessageThatDoesNotFitIsNotCopiedToPrivateMemory) {
  auto publisher = create_publisher<Parts>(node, "parts", 1);
  Parts first;  // fits at first, and then does not
  first.parts.assign(200, Part(1 << 20));
  Parts second;  // does not fit at all
  second.parts.assign(1, Part(100 << 20));
  second.parts.resize(200, Part(100));
  const auto publish = [&](const Parts& parts) {
    std::unique_ptr<Parts> message;
    std::thread([&] { message = std::make_unique<Parts>(parts); }).join();
    const Parts* const before = message.get();
    parts_copied = 0;
    const PublishResult result = publisher->publish(std::move(message));
    EXPECT_TRUE(is_full(result.code)) << sentence_of(result.code);
    EXPECT_EQ(result.adopted_bytes, 0u);
    EXPECT_EQ(message.get(), before) << "the caller still has it";
    return parts_copied;
  };
  for (int round = 0; round < 3; ++round) {
    // The first part that does not fit ends the copy.
    EXPECT_LE(publish(first), 65) << round;
    EXPECT_EQ(publish(second), 1) << round;
  }
  auto fits = std::make_unique<Parts>();
  fits->parts.assign(40, Part(1 << 20));
  EXPECT_TRUE(publisher->publish(std::move(fits))) << "the copies leaked nothing";
}

}  // namespace
}  // namespace agnocast
