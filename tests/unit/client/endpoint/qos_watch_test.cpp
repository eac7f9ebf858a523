// SPDX-License-Identifier: Apache-2.0
//
// Goal: DeadlineWatch counts each period that ended without a message once, and LeaseWatch knows
// who is alive, whenever somebody looks.
// Method: a clock of the test's own.

#include <client/endpoint/qos_watch.hpp>

#include <gtest/gtest.h>

namespace agnocast {
namespace {

class Deadline : public testing::Test {
 protected:
  Deadline() { watch.begin(100, 1000); }
  DeadlineWatch watch;
};

TEST(NoDeadline, IsNeverMissed) {
  DeadlineWatch watch;
  watch.begin(0, 1000);
  EXPECT_EQ(watch.next_ns(), never_ns);
  EXPECT_EQ(watch.look(1'000'000, 1), 0u);
  EXPECT_EQ(watch.next_ns(), never_ns);
}

TEST_F(Deadline, BeginsWithTheFirstMessage) {
  EXPECT_EQ(watch.next_ns(), 1100u);
  EXPECT_EQ(watch.look(1100, 0), 0u);
  EXPECT_EQ(watch.next_ns(), 1200u);
  EXPECT_EQ(watch.look(5000, 4950), 0u);
  EXPECT_EQ(watch.next_ns(), 5050u);
}

TEST_F(Deadline, HistoryIsNoMessage) {
  EXPECT_EQ(watch.look(2000, 999), 0u);
  EXPECT_EQ(watch.next_ns(), 2100u);
}

TEST_F(Deadline, EachPeriodIsMissedOnce) {
  EXPECT_EQ(watch.look(2099, 2000), 0u);
  EXPECT_EQ(watch.look(2100, 2000), 1u);
  EXPECT_EQ(watch.look(2100, 2000), 0u);
  EXPECT_EQ(watch.next_ns(), 2200u);
  EXPECT_EQ(watch.look(2450, 2000), 3u);
  EXPECT_EQ(watch.next_ns(), 2500u);
}

TEST_F(Deadline, AMessageBeginsAPeriod) {
  EXPECT_EQ(watch.look(2050, 2000), 0u);
  EXPECT_EQ(watch.look(2160, 2060), 1u);
  EXPECT_EQ(watch.look(2260, 2250), 0u);
  EXPECT_EQ(watch.next_ns(), 2350u);
}

TEST_F(Deadline, AnUnknownMessageChangesNothing) {
  EXPECT_EQ(watch.look(2050, 2000), 0u);
  EXPECT_EQ(watch.look(2150, 0), 1u);
  EXPECT_EQ(watch.look(2250, 1), 1u);
}

// A stamp is written by another process.
TEST_F(Deadline, AMessageOfTheFutureIsOneOfNow) {
  EXPECT_EQ(watch.look(2000, UINT64_MAX), 0u);
  EXPECT_EQ(watch.next_ns(), 2100u);
  EXPECT_EQ(watch.look(2100, 2000), 1u);
}

TEST_F(Deadline, ALongOneDoesNotOverflow) {
  watch.begin(INT64_MAX, 1000);
  EXPECT_EQ(watch.look(2000, 1500), 0u);
  EXPECT_EQ(watch.next_ns(), never_ns);
}

class Lease : public testing::Test {
 protected:
  Lease() { watch.begin(100, 1000); }
  LeaseWatch watch;
};

TEST(NoLease, NeverEnds) {
  LeaseWatch watch;
  watch.begin(0, 1000);
  EXPECT_FALSE(watch.look(1'000'000, 1));
  EXPECT_TRUE(watch.is_alive());
  EXPECT_EQ(watch.next_ns(), never_ns);
}

TEST_F(Lease, LastsAsLongAsItSays) {
  EXPECT_EQ(watch.next_ns(), 1101u);
  EXPECT_FALSE(watch.look(1100, 1000));
  EXPECT_TRUE(watch.is_alive());
  EXPECT_TRUE(watch.look(1101, 1000));
  EXPECT_FALSE(watch.is_alive());
  EXPECT_EQ(watch.next_ns(), 1152u) << "it may be alive again";
  EXPECT_FALSE(watch.look(1201, 1000)) << "it changes once";
}

TEST_F(Lease, BeginsAnewWhenItIsShown) {
  EXPECT_FALSE(watch.look(1090, 1080));
  EXPECT_EQ(watch.next_ns(), 1181u);
  EXPECT_TRUE(watch.look(1200, 1080));
  EXPECT_TRUE(watch.look(1250, 1240));
  EXPECT_TRUE(watch.is_alive());
}

TEST_F(Lease, CannotBeShownInTheFuture) {
  EXPECT_FALSE(watch.look(1050, UINT64_MAX));
  EXPECT_EQ(watch.next_ns(), 1151u);
  EXPECT_TRUE(watch.look(1151, 1050));
}

}  // namespace
}  // namespace agnocast
