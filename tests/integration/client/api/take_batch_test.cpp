// SPDX-License-Identifier: Apache-2.0
//
// Goal: take_batch() gives the same messages as repeated take(), and each of them is as
// independent as one of take().
// Method: two equal subscriptions hear the same publishers; the test calls take() on one and
// take_batch() on the other. Publishers and subscriptions are in this process, with the real
// daemon and the real heap hook. A batch without memory: memory_shortage_test.cpp; in a forked
// child: fork_test.cpp; amid deaths and lost daemons: sweep_clients, whose `drain` uses batches.

#include <agnocast/agnocast.hpp>
#include <tests/integration/client/programs/second_process.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gmock/gmock.h>

#include <algorithm>
#include <array>
#include <condition_variable>
#include <cstdint>
#include <cstdlib>
#include <mutex>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using test::Block;
using test::PlainNode;
using testing::ElementsAre;
using Values = std::vector<std::uint64_t>;
using Message = ipc_shared_ptr<const Block>;

void publish(Publisher<Block>& publisher, std::uint64_t value) {
  auto loan = publisher.borrow_loaned_message();
  loan->fill(value, 100);
  ASSERT_TRUE(publisher.publish(std::move(loan)));
}

Values values_of(const Message* messages, std::size_t count) {
  Values values;
  for (std::size_t i = 0; i < count; ++i) {
    EXPECT_TRUE(messages[i]->is_intact());
    values.push_back(messages[i]->value);
  }
  return values;
}

Values one_by_one(Subscription<Block>& subscription) {
  Values values;
  while (const Message message = subscription.take()) values.push_back(message->value);
  return values;
}
/// Returns all unread values, in batches of `size`.
Values in_batches(Subscription<Block>& subscription, std::size_t size) {
  Values values;
  std::vector<Message> messages(size);
  while (const std::size_t count = subscription.take_batch(messages.data(), size)) {
    const Values some = values_of(messages.data(), count);
    values.insert(values.end(), some.begin(), some.end());
  }
  return values;
}

class TakeBatch : public test::SuiteDaemon {
 protected:
  /// A topic of this test's own.
  void begin(std::size_t publisher_count, const QoS& qos, const SubscriptionOptions& options = {}) {
    topic_ = test_name();
    singly = create_subscription<Block>(node, topic_, qos, options);
    batched = create_subscription<Block>(node, topic_, qos, options);
    while (publishers.size() < publisher_count)
      publishers.push_back(create_publisher<Block>(node, topic_, qos));
    for (const auto& publisher : publishers)
      ASSERT_TRUE(
          test::eventually([&] { return publisher->get_linked_subscription_count() == 2; }));
  }
  /// Publishes `first` to `last`, each by a random publisher.
  void publish_all(std::uint64_t first, std::uint64_t last) {
    for (std::uint64_t value = first; value <= last; ++value)
      publish(*publishers[random_() % publishers.size()], value);
  }

  PlainNode node;
  std::vector<Publisher<Block>::SharedPtr> publishers;
  Subscription<Block>::SharedPtr singly, batched;

 private:
  std::string topic_;
  std::mt19937 random_{1};
};

/// A thread publishes `count` messages by eight publishers in turn, while this one takes `size` at
/// once. Returns how many come after one that was published later.
std::uint64_t inversions_of(PlainNode& node, const std::string& topic, std::size_t size,
                            std::uint64_t count) {
  const auto subscription = create_subscription<Block>(node, topic, QoS(100));
  std::vector<Publisher<Block>::SharedPtr> publishers;
  while (publishers.size() < 8)
    publishers.push_back(create_publisher<Block>(node, topic, QoS(100)));
  for (const auto& publisher : publishers)
    EXPECT_TRUE(test::eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  std::thread publishes([&] {
    for (std::uint64_t value = 1; value <= count; ++value) {
      auto loan = publishers[value % publishers.size()]->borrow_loaned_message();
      loan->value = value;
      EXPECT_TRUE(publishers[value % publishers.size()]->publish(std::move(loan)));
    }
  });
  std::uint64_t last = 0, inversions = 0;
  std::vector<Message> messages(size);
  while (last != count) {
    std::size_t taken = 0;
    if (size == 1) {
      messages[0] = subscription->take();
      taken = messages[0] ? 1 : 0;
    } else {
      taken = subscription->take_batch(messages.data(), size);
    }
    for (std::size_t i = 0; i < taken; ++i) {
      if (messages[i]->value < last) ++inversions;
      last = std::max(last, messages[i]->value);
    }
  }
  publishes.join();
  return inversions;
}

// Losses do not matter.
TEST_F(TakeBatch, KeepsTheOrderInWhichAThreadPublishesByManyPublishers) {
  EXPECT_EQ(inversions_of(node, "many_singly", 1, 1'000'000), 0u);
  EXPECT_EQ(inversions_of(node, "many_in_batches", 16, 1'000'000), 0u);
}

TEST_F(TakeBatch, GivesTheOldestInOrderAndNoMoreThanExist) {
  ASSERT_NO_FATAL_FAILURE(begin(1, QoS(20)));
  publish_all(1, 10);
  std::array<Message, 4> messages;
  EXPECT_EQ(batched->take_batch(messages.data(), 0), 0u);
  ASSERT_EQ(batched->take_batch(messages.data(), 4), 4u);
  EXPECT_THAT(values_of(messages.data(), 4), ElementsAre(1, 2, 3, 4));
  EXPECT_EQ(messages[3].info().sequence, 4u);
  EXPECT_EQ(messages[3].info().object_bytes, sizeof(Block));
  EXPECT_GE(messages[3].info().publish_time_ns, messages[2].info().publish_time_ns);
  EXPECT_EQ(batched->take()->value, 5u) << "each way continues where the other was";
  ASSERT_EQ(batched->take_batch(messages.data(), 3), 3u);
  EXPECT_THAT(values_of(messages.data(), 3), ElementsAre(6, 7, 8));
  EXPECT_TRUE(messages[3]) << "entries beyond the batch are not touched";
  ASSERT_EQ(batched->take_batch(messages.data(), 4), 2u);
  EXPECT_THAT(values_of(messages.data(), 2), ElementsAre(9, 10));
  EXPECT_FALSE(messages[2] || messages[3]) << "old entries are released";
  EXPECT_EQ(batched->take_batch(messages.data(), 4), 0u);
  EXPECT_FALSE(messages[0]);
  EXPECT_EQ(batched->get_lost_count(), 0u);
}

TEST_F(TakeBatch, KeepsTheOrderBetweenPublishers) {
  ASSERT_NO_FATAL_FAILURE(begin(4, QoS(100)));
  for (const std::size_t size : {1u, 2u, 7u, 100u}) {
    publish_all(1, 60);
    const Values singles = one_by_one(*singly);
    EXPECT_EQ(singles.size(), 60u);
    EXPECT_EQ(in_batches(*batched, size), singles) << "in batches of " << size;
  }
}

TEST_F(TakeBatch, LosesTheSameAsTake) {
  for (const std::size_t publisher_count : {1u, 3u}) {
    ASSERT_NO_FATAL_FAILURE(begin(publisher_count, QoS(5)));
    const std::uint64_t lost_before = singly->get_lost_count();
    publish_all(1, 3);
    std::array<Message, 2> two;
    ASSERT_EQ(batched->take_batch(two.data(), 2), 2u);
    EXPECT_EQ(values_of(two.data(), 2), (Values{singly->take()->value, singly->take()->value}));
    publish_all(4, 11);
    EXPECT_EQ(in_batches(*batched, 16), one_by_one(*singly));
    EXPECT_EQ(singly->get_lost_count() - lost_before, 4u);
    EXPECT_EQ(batched->get_lost_count(), singly->get_lost_count());
    singly.reset();
    batched.reset();
  }
}

TEST_F(TakeBatch, EndsAtTheHoldQuota) {
  ASSERT_NO_FATAL_FAILURE(begin(1, QoS(20), SubscriptionOptions().hold_quota(6)));
  publish_all(1, 14);
  const Message first = batched->take(), second = batched->take();
  std::array<Message, 16> messages, others;
  EXPECT_EQ(batched->take_batch(messages.data(), 16), 4u);
  EXPECT_EQ(batched->take_batch(others.data(), 16), 0u) << "six are held";
  ASSERT_EQ(batched->take_batch(messages.data(), 16), 4u) << "which releases four";
  EXPECT_THAT(values_of(messages.data(), 4), ElementsAre(7, 8, 9, 10));
  messages[1].reset();
  ASSERT_EQ(batched->take_batch(others.data(), 16), 1u);
  EXPECT_EQ(others[0]->value, 11u);
  EXPECT_EQ(batched->get_lost_count(), 0u);
}

TEST_F(TakeBatch, EachMessageIsHeldByItself) {
  ASSERT_NO_FATAL_FAILURE(begin(2, QoS(8)));
  publish_all(1, 8);
  std::vector<Message> messages(8);
  ASSERT_EQ(batched->take_batch(messages.data(), 8), 8u);
  const Message third = messages[2];
  Message sixth = std::move(messages[5]);
  messages.clear();
  (void)one_by_one(*singly);
  // Freed memory is used again.
  for (std::uint64_t value = 100; value < 400; ++value) {
    publish_all(value, value);
    EXPECT_EQ(in_batches(*batched, 3), one_by_one(*singly));
  }
  EXPECT_TRUE(third->is_intact() && third->value == 3);
  batched.reset();
  publishers.clear();
  EXPECT_TRUE(sixth->is_intact() && sixth->value == 6) << "its endpoints are gone";
  sixth.reset();
  EXPECT_TRUE(third->is_intact() && third->value == 3);
}

TEST_F(TakeBatch, GivesAllMessagesOfAnEndedPublisher) {
  ASSERT_NO_FATAL_FAILURE(begin(2, QoS(20)));
  publish_all(1, 20);
  publishers.pop_back();
  ASSERT_TRUE(test::eventually([&] { return batched->get_linked_publisher_count() == 1; }));
  ASSERT_TRUE(test::eventually([&] { return singly->get_linked_publisher_count() == 1; }));
  EXPECT_EQ(in_batches(*batched, 6), one_by_one(*singly));
  publish_all(21, 21);
  EXPECT_THAT(in_batches(*batched, 6), ElementsAre(21));
}

// This thread reuses released memory while others release.
TEST_F(TakeBatch, MessagesAreReleasedByOtherThreadsMeanwhile) {
  ASSERT_NO_FATAL_FAILURE(begin(1, QoS(48)));
  std::mutex mutex;
  std::condition_variable changed;
  std::vector<Message> handed_over;
  bool is_over = false;
  std::uint64_t damaged = 0;
  const auto release = [&] {
    std::unique_lock lock(mutex);
    for (;;) {
      changed.wait(lock, [&] { return is_over || !handed_over.empty(); });
      if (handed_over.empty()) return;
      Message message = std::move(handed_over.back());
      handed_over.pop_back();
      lock.unlock();
      const bool is_intact = message->is_intact();
      message.reset();
      lock.lock();
      damaged += !is_intact;
    }
  };
  std::thread one(release), two(release);
  std::uint64_t published = 0, expected = 1;
  std::array<Message, 16> messages;
  bool in_order = true;
  while (expected <= 4000 && in_order) {
    if (published < expected + 30) publish_all(published + 1, published + 1), ++published;
    const std::size_t count = batched->take_batch(messages.data(), 1 + published % 16);
    const Values values = values_of(messages.data(), count);
    for (const std::uint64_t value : values) in_order = in_order && value == expected++;
    const std::lock_guard lock(mutex);
    for (std::size_t i = 0; i < count; ++i) handed_over.push_back(std::move(messages[i]));
    changed.notify_all();
  }
  {
    const std::lock_guard lock(mutex);
    is_over = true;
    changed.notify_all();
  }
  one.join();
  two.join();
  EXPECT_TRUE(in_order) << "at " << expected;
  EXPECT_EQ(damaged, 0u);
}

}  // namespace
}  // namespace agnocast
