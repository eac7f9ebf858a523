// SPDX-License-Identifier: Apache-2.0
//
// Goal: a subscription takes no message that is older than its publisher's lifespan, and passes
// over older ones without losing, holding or delaying anything else.
// Method: publishers and subscriptions in this process, with the real daemon and the real heap
// hook. A lifespan of a nanosecond is over before a take, one of an hour is not; whatever lies
// between is compared with clocks read before and after the take.

#include <agnocast/agnocast.hpp>
#include <tests/integration/client/programs/second_process.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gmock/gmock.h>

#include <array>
#include <chrono>
#include <cstdint>
#include <ctime>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using namespace std::chrono_literals;
using std::chrono::nanoseconds;
using test::Block;
using test::PlainNode;
using testing::ElementsAre;
using Values = std::vector<std::uint64_t>;

constexpr nanoseconds at_once = 1ns, for_long = 1h;

std::uint64_t monotonic_now() {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return static_cast<std::uint64_t>(now.tv_sec) * 1'000'000'000 +
         static_cast<std::uint64_t>(now.tv_nsec);
}

Values values_of(Subscription<Block>& subscription) {
  Values values;
  while (const auto message = subscription.take()) {
    EXPECT_TRUE(message->is_intact());
    values.push_back(message->value);
  }
  return values;
}

class Lifespan : public test::SuiteDaemon {
 protected:
  Publisher<Block>::SharedPtr publisher(nanoseconds lifespan, QoS qos = QoS(10)) {
    const auto made = create_publisher<Block>(node, own("topic"), qos.lifespan(lifespan));
    if (listener != nullptr) await(*made);
    return made;
  }
  /// Also where it is requested, a lifespan is the publisher's.
  void listen(const QoS& qos = QoS(10)) {
    listener = create_subscription<Block>(node, own("topic"), QoS(qos).lifespan(at_once));
  }
  static void await(Publisher<Block>& publisher) {
    ASSERT_TRUE(test::eventually([&] { return publisher.get_linked_subscription_count() == 1; }));
  }

  /// Publishes, and returns when the message is older than a nanosecond.
  static void publish(Publisher<Block>& publisher, std::uint64_t value) {
    auto loan = publisher.borrow_loaned_message();
    loan->fill(value, 100);
    ASSERT_TRUE(publisher.publish(std::move(loan)));
    for (const std::uint64_t now = monotonic_now(); monotonic_now() < now + 2;) {
    }
  }

  PlainNode node;
  Subscription<Block>::SharedPtr listener;
};

TEST_F(Lifespan, OlderMessagesAreNotTakenAndAreNotLost) {
  listen();
  const auto brief = publisher(at_once);
  for (std::uint64_t value = 1; value <= 5; ++value) publish(*brief, value);
  EXPECT_THAT(values_of(*listener), ElementsAre());
  EXPECT_EQ(listener->get_lost_count(), 0u);
}

TEST_F(Lifespan, ThoseOfOtherPublishersComeInTheirOrder) {
  listen();
  const auto brief = publisher(at_once), lasting = publisher(for_long), other = publisher(0ns);
  publish(*brief, 1);
  publish(*lasting, 2);
  publish(*brief, 3);
  publish(*brief, 4);
  publish(*other, 5);
  publish(*lasting, 6);
  publish(*brief, 7);
  EXPECT_THAT(values_of(*listener), ElementsAre(2, 5, 6));
  EXPECT_EQ(listener->get_lost_count(), 0u);
}

TEST_F(Lifespan, OlderMessagesDisplaceNoneOfOtherPublishers) {
  listen(QoS(3));
  const auto brief = publisher(at_once), lasting = publisher(for_long), other = publisher(0ns);
  publish(*lasting, 1);
  for (std::uint64_t value = 2; value <= 4; ++value) publish(*brief, value);
  publish(*other, 5);
  EXPECT_THAT(values_of(*listener), ElementsAre(1, 5));
  EXPECT_EQ(listener->get_lost_count(), 0u);
}

TEST_F(Lifespan, ABatchHasNoOlderMessage) {
  listen();
  const auto brief = publisher(at_once);
  publish(*brief, 1);
  publish(*brief, 2);
  std::array<ipc_shared_ptr<const Block>, 4> batch;
  EXPECT_EQ(listener->take_batch(batch.data(), batch.size()), 0u);
  const auto lasting = publisher(for_long);
  for (std::uint64_t value = 3; value <= 6; ++value)
    publish(value % 2 == 0 ? *brief : *lasting, value);
  ASSERT_EQ(listener->take_batch(batch.data(), batch.size()), 2u);
  EXPECT_EQ(batch[0]->value, 3u);
  EXPECT_EQ(batch[1]->value, 5u);
}

TEST_F(Lifespan, EndsBetweenTwoTakes) {
  listen();
  const nanoseconds lifespan = 20ms;
  const auto brief = publisher(lifespan);
  std::uint64_t taken = 0, passed_over = 0;
  for (std::uint64_t value = 1; value <= 40; ++value) {
    const std::uint64_t before_publish = monotonic_now();
    publish(*brief, value);
    const std::uint64_t after_publish = monotonic_now();
    std::this_thread::sleep_for(value % 2 == 0 ? 0ms : 25ms);
    const std::uint64_t before_take = monotonic_now();
    const auto message = listener->take();
    const std::uint64_t after_take = monotonic_now();
    const auto limit = static_cast<std::uint64_t>(lifespan.count());
    if (message) {
      ++taken;
      EXPECT_EQ(message->value, value);
      EXPECT_LE(before_take, after_publish + limit) << "it was too old";
    } else {
      ++passed_over;
      EXPECT_GT(after_take, before_publish + limit) << "it was young";
    }
  }
  EXPECT_GT(passed_over, 0u);
  RecordProperty("taken", std::to_string(taken));
}

TEST_F(Lifespan, ALateJoinerGetsNoOldHistory) {
  const QoS kept = QoS(10).transient_local();
  const auto brief = publisher(at_once, kept), lasting = publisher(for_long, kept);
  publish(*brief, 1);
  publish(*lasting, 2);
  publish(*brief, 3);
  listen(kept);
  await(*brief);
  await(*lasting);
  EXPECT_THAT(values_of(*listener), ElementsAre(2));
}

TEST_F(Lifespan, OlderMessagesHoldBackNoKeepAllPublisher) {
  listen(QoS(1).keep_all(5));
  const auto brief = publisher(at_once, QoS(1).keep_all(5));
  for (std::uint64_t value = 1; value <= 5; ++value) publish(*brief, value);
  auto loan = brief->borrow_loaned_message();
  loan->fill(6, 100);
  EXPECT_FALSE(brief->publish(std::move(loan))) << "it does not know that they are not wanted";
  EXPECT_THAT(values_of(*listener), ElementsAre());
  for (std::uint64_t value = 7; value <= 200; ++value) {
    publish(*brief, value);
    EXPECT_FALSE(listener->take());
  }
  EXPECT_EQ(listener->get_lost_count(), 0u);
}

TEST_F(Lifespan, ACallbackIsNotCalledForOlderMessages) {
  Node here(own("node"));
  Values called;
  const auto subscription = here.create_subscription<Block>(
      own("topic"), QoS(10),
      [&](const ipc_shared_ptr<const Block>& block) { called.push_back(block->value); });
  const auto brief = here.create_publisher<Block>(own("topic"), QoS(10).lifespan(at_once));
  const auto lasting = here.create_publisher<Block>(own("topic"), QoS(10).lifespan(for_long));
  await(*brief);
  await(*lasting);
  SingleThreadedExecutor executor;
  executor.add_node(here);
  publish(*brief, 1);
  publish(*lasting, 2);
  publish(*brief, 3);
  while (called.empty()) executor.spin_once();
  executor.spin_some();
  EXPECT_THAT(called, ElementsAre(2));
}

TEST_F(Lifespan, OlderMessagesOfAGonePublisherKeepNothingOfIt) {
  listen();
  auto brief = publisher(at_once);
  publish(*brief, 1);
  publish(*brief, 2);
  EXPECT_EQ(listener->get_linked_publisher_count(), 1u);
  brief.reset();
  EXPECT_TRUE(test::eventually([&] { return listener->get_linked_publisher_count() == 0; }));
  EXPECT_THAT(values_of(*listener), ElementsAre());
  // Its place is free again: a topic has 256.
  for (int i = 0; i < 300; ++i) {
    const auto next = publisher(at_once);
    publish(*next, 3);
    EXPECT_FALSE(listener->take());
  }
  EXPECT_EQ(listener->get_lost_count(), 0u);
}

TEST_F(Lifespan, ANegativeTimeIsRefused) {
  for (const QoS& qos :
       {QoS(1).lifespan(-1ns), QoS(1).deadline(-1ns), QoS(1).liveliness_lease_duration(-1ns)}) {
    const auto made = try_create_publisher<Block>(node, own("topic"), qos);
    ASSERT_FALSE(made);
    EXPECT_EQ(made.error().code, Errc::invalid_argument);
    EXPECT_THAT(detail_of(made.error()), testing::HasSubstr("of -1 ns is negative"));
  }
}

}  // namespace
}  // namespace agnocast
