// SPDX-License-Identifier: Apache-2.0
//
// Goal: an ordinary program goes on when the daemon's store is lost: callbacks in any executor
// are woken, loans and held messages stay valid, a stream from another process arrives whole and
// in order.
// Method: the public interface, real daemons that are killed with their supervisors and restarted
// without a store at the same socket, a second process that publishes.

#include <tests/integration/client/session/reregistration_in_process.hpp>
#include <tests/support/processes/spun.hpp>

#include <algorithm>
#include <cstdint>
#include <functional>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

namespace agnocast {
namespace {

using test::SecondProcess;
using test::Spun;

class ReregistrationOfNodes : public ReregistrationInProcess {};

/// The values that a callback got, in the thread that it ran in.
struct Seen {
  std::mutex mutex;
  std::vector<std::uint64_t> values;
  void add(std::uint64_t value) {
    const std::lock_guard lock(mutex);
    values.push_back(value);
  }
  std::size_t count() {
    const std::lock_guard lock(mutex);
    return values.size();
  }
  /// Waits until it has `wanted` values, as long as further ones arrive: a busy machine needs
  /// longer.
  bool reaches(std::size_t wanted) {
    for (std::size_t had = count(); had < wanted; had = count())
      if (!eventually([&] { return count() > had; })) return false;
    return true;
  }
};

TEST_F(ReregistrationOfNodes, CallbacksAreWokenWhereverTheySleep) {
  Spun<Node> background_node("in_background");
  Node executor_node("by_executor"), talker("talker");
  Seen in_background, by_executor;
  const auto one = background_node.create_subscription<Number>(
      "/woken", 10, [&](ipc_shared_ptr<const Number> number) { in_background.add(number->value); });
  const auto two = executor_node.create_subscription<Number>(
      "/woken", 10, [&](ipc_shared_ptr<const Number> number) { by_executor.add(number->value); });
  const auto polled = talker.create_subscription<Number>("/woken", 1);
  const auto publisher = talker.create_publisher<Number>("/woken", 10);
  SingleThreadedExecutor executor;
  executor.add_node(executor_node);
  std::thread spins([&] { executor.spin(); });
  std::uint64_t value = 0;
  for (int round = 0; round < 4; ++round) {
    for (int i = 0; i < 3; ++i) {
      publish(*publisher, ++value);
      // Each sleeps again before the next one.
      EXPECT_TRUE(eventually([&] { return in_background.count() == value; })) << value;
      EXPECT_TRUE(eventually([&] { return by_executor.count() == value; })) << value;
    }
    const auto newest = polled->take_data();
    ASSERT_TRUE(newest);
    EXPECT_EQ(newest->value, value);
    lose();
    EXPECT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 3; }));
  }
  executor.cancel();
  spins.join();
  EXPECT_EQ(in_background.values, range(1, value));
  EXPECT_EQ(by_executor.values, range(1, value));
  EXPECT_EQ(one->get_lost_count(), 0u);
  EXPECT_TRUE(eventually([&] { return one->get_linked_publisher_count() == 1; }));
}

// Each message of history that their publisher moves rings the callbacks, and they read the queue
// while it moves the next ones.
TEST_F(ReregistrationOfNodes, HistoryArrivesOnceWhileItIsMoved) {
  constexpr std::uint64_t kept = 300;
  Node talker("talker");
  const auto publisher =
      talker.create_publisher<Number>("/brought", test::qos_of(std::to_string(kept) + "rt"));
  struct Listener {
    Spun<Node> node;
    Seen seen;
    Subscription<Number>::SharedPtr subscription;
    Listener(const char* name, const char* qos) : node(name) {
      subscription = node.create_subscription<Number>(
          "/brought", test::qos_of(qos),
          [this](ipc_shared_ptr<const Number> number) { seen.add(number->value); });
    }
  };
  Listener keeps_history("keeps_history", "1000rt"), keeps_none("keeps_none", "1000rv"),
      keeps_one("keeps_one", "1rt");
  Listener* const listeners[] = {&keeps_history, &keeps_none, &keeps_one};
  std::uint64_t value = 0;
  const auto publish_one = [&] {
    EXPECT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 3; }));
    publish(*publisher, ++value);
    for (Listener* const listener : listeners)
      EXPECT_TRUE(eventually([&] { return listener->seen.count() >= value; })) << value;
  };
  while (value < kept) publish_one();
  for (int round = 0; round < 5; ++round) {
    lose();
    publish_one();
  }
  for (Listener* const listener : listeners) {
    const std::lock_guard lock(listener->seen.mutex);
    const auto& values = listener->seen.values;
    const auto wrong = std::adjacent_find(values.begin(), values.end(), std::greater_equal<>());
    EXPECT_EQ(wrong - values.begin(), values.end() - values.begin())
        << listener->node.get_name() << ": " << wrong[1] << " after " << wrong[0];
    EXPECT_EQ(values.size(), value) << listener->node.get_name();
    EXPECT_EQ(listener->subscription->get_lost_count(), 0u) << listener->node.get_name();
  }
}

TEST_F(ReregistrationOfNodes, LoansAndHeldMessagesStayValid) {
  Node node("holder");
  const auto subscription = node.create_subscription<Number>("/held", 10);
  const auto publisher = node.create_publisher<Number>("/held", 10);
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  publish(*publisher, 1);
  auto held = subscription->take();
  ASSERT_TRUE(held);
  auto loan = publisher->borrow_loaned_message();
  loan->value = 2;
  for (int round = 0; round < 2; ++round) {
    lose();
    ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
    EXPECT_EQ(held->value, 1u);
  }
  const PublishResult published = publisher->publish(std::move(loan));
  EXPECT_TRUE(published);
  EXPECT_EQ(published.adopted_bytes, 0u) << "its memory is shared as before";
  const auto next = subscription->take();
  ASSERT_TRUE(next);
  EXPECT_EQ(next->value, 2u);
  EXPECT_EQ(held->value, 1u);
  held.reset();
  publish(*publisher, 3);
  const auto last = subscription->take();
  ASSERT_TRUE(last);
  EXPECT_EQ(last->value, 3u);
}

TEST_F(ReregistrationOfNodes, AStreamOfAnotherProcessArrivesWhole) {
  constexpr std::uint64_t count = 200'000;
  Spun<Node> node("listener");
  Seen seen;
  const auto subscription = node.create_subscription<Number>(
      "/stream", test::qos_of("20rva"),
      [&](ipc_shared_ptr<const Number> number) { seen.add(number->value); });
  SecondProcess other({"publish", "/stream", "20rva", std::to_string(count)});
  for (int round = 1; round <= 3; ++round) {
    ASSERT_TRUE(seen.reaches(count / 10 * static_cast<unsigned>(round)));
    lose();
  }
  EXPECT_TRUE(seen.reaches(count));
  EXPECT_EQ(seen.values, range(1, count));
  EXPECT_EQ(subscription->get_lost_count(), 0u);
}

TEST_F(ReregistrationOfNodes, ConnectionCallbacksReportTheLoss) {
  Spun<Node> node("asks");
  std::mutex mutex;
  std::vector<ConnectionState> told;
  SubscriptionOptions options;
  options.connection_callback([&](ConnectionInfo& info) {
    const std::lock_guard lock(mutex);
    told.push_back(info.state);
  });
  const auto subscription = node.create_subscription<Number>("/told", 1, options);
  lose();
  // Two changes before the notification are reported as one.
  EXPECT_TRUE(eventually([&] {
    const std::lock_guard lock(mutex);
    return !told.empty() && told.back() == ConnectionState::connected;
  }));
  EXPECT_EQ(orphan_reason(), Errc::ok);
}

}  // namespace
}  // namespace agnocast
