// SPDX-License-Identifier: Apache-2.0
//
// Goal: a publisher withdraws a reader that keeps too much, and serves the next reader as before.
// Method: as in dataplane_test.cpp.

#include <tests/unit/dataplane/dataplane_pair.hpp>

namespace agnocast::dataplane {
namespace {

struct Withdrawing : Pair {
  explicit Withdrawing(std::uint64_t quota = 2, abi::Qos qos = {1, false, true, false, false})
      : core(std::make_unique<PublisherCore<M>>(
            PublisherCore<M>::Identity{topic(), words(), 0, generation, first(), qos, 3, 0})) {
    offered.depth = requested.depth = 1;
    journal::BoardSteps<M>(topic()).add_publisher(0, generation, {offered, 0, extent, 3});
    join(1, quota);
  }
  void join(std::uint64_t subscription_generation, std::uint64_t quota) {
    journal::BoardSteps<M>(topic()).add_subscription(0, subscription_generation,
                                                     {requested, 1, extent, quota, 0});
  }
  void attach(std::uint64_t subscription_generation) {
    core->attach(0, subscription_generation, subscriber[0].base(), extent,
                 offsetof(abi::ClientRegionHeader, wait_set), 0, environment);
    core->scan(environment);
  }
  bool publish() {
    const std::uint64_t address = window.base + ++number * 16;
    environment.live.insert(address);
    const bool done =
        core->publish({address, 16, number, 100}, environment) == PublishOutcome::published;
    if (!done) environment.live.erase(address);
    return done;
  }
  Freed environment;
  NumberWindow window;
  std::unique_ptr<PublisherCore<M>> core;
  std::uint64_t number = 0;
};

TEST(DataplaneWithdrawing, KeepsHeldMessagesUntilReleaseAndDeliversNothingMore) {
  Withdrawing pair;
  pair.attach(1);
  LinkCore<M> reader = pair.link(0);
  ASSERT_TRUE(reader.link(true));
  ASSERT_TRUE(pair.publish());
  const auto held = reader.take(pair.window);
  ASSERT_TRUE(held);
  const PublisherCore<M>::EndpointId ids[] = {{0, 1}, {0, 1}};
  EXPECT_EQ(pair.core->kept_bytes(ids), 100u) << "a duplicate id counts once";
  ASSERT_TRUE(pair.publish());
  EXPECT_EQ(pair.core->kept_bytes(ids), 200u) << "one is held, one unread";
  ASSERT_TRUE(pair.core->withdraw(0, 1, abi::Withdrawal::over_share));
  for (int i = 0; i < 8; ++i) ASSERT_TRUE(pair.publish());
  EXPECT_TRUE(pair.environment.live.count(held->address));
  EXPECT_FALSE(reader.take(pair.window));
  EXPECT_FALSE(reader.has_news()) << "has_news() would make an executor spin";
  EXPECT_EQ(reader.unread(), 0u);
  EXPECT_EQ(pair.core->withdrawal(0, 1), abi::Withdrawal::over_share);
  EXPECT_FALSE(pair.core->is_disregarded(0));
  reader.release(held->slot);
  pair.core->scan(pair.environment);
  EXPECT_TRUE(pair.core->is_disregarded(0));
  EXPECT_FALSE(pair.environment.live.count(held->address));
}

// A map for late joiners is kept even without this reader.
TEST(DataplaneWithdrawing, DoesNotCountTheHistoryAsKeptByAReader) {
  Withdrawing pair(2, {1, true, true, false, false});
  pair.attach(1);
  LinkCore<M> reader = pair.link(0);
  ASSERT_TRUE(reader.link(true));
  ASSERT_TRUE(pair.publish());
  const PublisherCore<M>::EndpointId ids[] = {{0, 1}};
  EXPECT_EQ(pair.core->kept_bytes(ids), 0u) << "unread";
  ASSERT_TRUE(reader.take(pair.window));
  EXPECT_EQ(pair.core->kept_bytes(ids), 0u) << "held";
  ASSERT_TRUE(pair.publish());
  EXPECT_EQ(pair.core->kept_bytes(ids), 100u) << "the previous map";
  pair.core->keep_no_history();
  EXPECT_EQ(pair.core->kept_bytes(ids), 200u);
}

TEST(DataplaneWithdrawing, DisregardsAReaderThatDoesNotRelease) {
  Withdrawing pair;
  pair.attach(1);
  LinkCore<M> reader = pair.link(0);
  ASSERT_TRUE(reader.link(true));
  for (int i = 0; i < 2; ++i) {
    ASSERT_TRUE(pair.publish());
    ASSERT_TRUE(reader.take(pair.window));
  }
  ASSERT_TRUE(pair.publish());
  ASSERT_FALSE(pair.publish()) << "every slot is held or the newest";
  ASSERT_TRUE(pair.core->withdraw(0, 1, abi::Withdrawal::over_share));
  ASSERT_FALSE(pair.core->is_disregarded(0));
  pair.core->disregard(0, 1);
  for (int i = 0; i < 8; ++i) EXPECT_TRUE(pair.publish());
}

TEST(DataplaneWithdrawing, IgnoresHoldsOfLaterMessages) {
  Withdrawing pair(3);
  pair.attach(1);
  LinkCore<M> reader = pair.link(0);
  ASSERT_TRUE(reader.link(true));
  ASSERT_TRUE(pair.publish());
  const auto held = reader.take(pair.window);
  ASSERT_TRUE(held);
  ASSERT_TRUE(pair.core->withdraw(0, 1, abi::Withdrawal::over_share));
  pair.line(0).hold(0).store(7);
  for (int i = 0; i < 8; ++i) ASSERT_TRUE(pair.publish());
  EXPECT_TRUE(pair.environment.live.count(held->address));
}

TEST(DataplaneWithdrawing, BoundsMemoryKeptForAReaderThatIsNeverMapped) {
  Withdrawing pair;
  pair.core->scan(pair.environment);
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(pair.publish());
  ASSERT_FALSE(pair.publish()) << "the unmapped reader may hold any message";
  std::uint64_t unmapped = 0;
  pair.core->for_each_unmapped([&](std::uint64_t index, std::uint64_t of) {
    EXPECT_EQ(index, 0u);
    EXPECT_EQ(of, 1u);
    ++unmapped;
  });
  EXPECT_EQ(unmapped, 1u);
  ASSERT_TRUE(pair.core->withdraw(0, 1, abi::Withdrawal::not_attached));
  pair.core->disregard(0, 1);
  for (int i = 0; i < 8; ++i) ASSERT_TRUE(pair.publish());
  // Finally mapped and served again.
  LinkCore<M> reader = pair.link(0);
  ASSERT_TRUE(reader.link(false));
  ASSERT_TRUE(pair.publish());
  EXPECT_FALSE(reader.take(pair.window));
  EXPECT_FALSE(pair.core->serve_again(0, 1, pair.environment)) << "not mapped yet";
  pair.attach(1);
  ASSERT_TRUE(pair.core->serve_again(0, 1, pair.environment));
  ASSERT_TRUE(pair.publish());
  const auto taken = reader.take(pair.window);
  ASSERT_TRUE(taken);
  for (int i = 0; i < 8; ++i) ASSERT_TRUE(pair.publish());
  EXPECT_TRUE(pair.environment.live.count(taken->address));
}

TEST(DataplaneWithdrawing, ServesTheNextReaderInItsPlace) {
  Withdrawing pair;
  pair.attach(1);
  ASSERT_TRUE(pair.core->withdraw(0, 1, abi::Withdrawal::over_share));
  pair.core->detach(0, 1);
  pair.join(2, 2);
  pair.attach(2);
  LinkCore<M> next = pair.link(0);
  ASSERT_TRUE(next.link(false));
  ASSERT_TRUE(pair.publish());
  EXPECT_TRUE(next.take(pair.window));
}

TEST(DataplaneWithdrawing, WithdrawsAReaderThatHoldsMoreThanItsQuota) {
  Withdrawing pair(1);
  pair.attach(1);
  LinkCore<M> reader = pair.link(0);
  ASSERT_TRUE(reader.link(true));
  pair.line(0).hold(0).store(~std::uint64_t{0});
  for (int i = 0; i < 8; ++i) ASSERT_TRUE(pair.publish());
  EXPECT_EQ(pair.core->withdrawal(0, 1), abi::Withdrawal::over_quota);
  EXPECT_FALSE(reader.take(pair.window));
}

TEST(DataplaneWithdrawing, GivesNoSlotBeyondTheQuota) {
  Withdrawing pair(2);
  pair.attach(1);
  LinkCore<M> reader = pair.link(0);
  ASSERT_TRUE(reader.link(true));
  pair.line(0).hold(0).store(7);
  for (int i = 0; i < 8; ++i)
    ASSERT_TRUE(pair.publish()) << "all slots are held, one more than the quota";
  EXPECT_EQ(pair.core->withdrawal(0, 1), abi::Withdrawal::over_quota);
}

}  // namespace
}  // namespace agnocast::dataplane
