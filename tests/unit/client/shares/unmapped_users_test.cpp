// SPDX-License-Identifier: Apache-2.0

#include <client/shares/unmapped_users.hpp>

#include <gtest/gtest.h>

namespace agnocast {
namespace {

using namespace std::chrono_literals;

struct UnmappedUsersTest : testing::Test {
  static constexpr PeerOwner one{1, false}, other{2, false}, self{3, true};
  UnmappedUsers users;
  UnmappedUsers::Clock::time_point now{1h};

  void look_for(int seconds, PeerOwner owner) {
    for (int i = 0; i < seconds; ++i, now += 1s) {
      users.note(owner);
      users.look(now);
    }
  }
  bool is_out(PeerOwner owner) const { return users.is_out(owner, now); }
};

TEST_F(UnmappedUsersTest, WaitsTenSecondsPerUser) {
  look_for(10, one);
  EXPECT_FALSE(is_out(one));
  look_for(1, other);
  look_for(1, one);
  EXPECT_TRUE(is_out(one));
  EXPECT_FALSE(is_out(other));
}

// Each subscription leaves in time, and briefly there is none.
TEST_F(UnmappedUsersTest, AddsUpIntervalsThatFollowEachOther) {
  for (int times = 0; times < 3 && !is_out(one); ++times) {
    look_for(5, one);
    users.look(now);
    now += 1s;
  }
  EXPECT_TRUE(is_out(one));
}

TEST_F(UnmappedUsersTest, ForgivesRareIntervals) {
  for (int times = 0; times < 100; ++times) {
    look_for(5, one);
    EXPECT_FALSE(is_out(one)) << times;
    for (int i = 0; i < 60; ++i, now += 1s) users.look(now);
  }
}

TEST_F(UnmappedUsersTest, StartsAgainAfterABan) {
  look_for(8, one);
  users.ban(one, now);
  now += UserBans::first;
  EXPECT_FALSE(is_out(one));
  look_for(10, one);
  EXPECT_FALSE(is_out(one));
  look_for(1, one);
  EXPECT_TRUE(is_out(one));
}

TEST_F(UnmappedUsersTest, AlwaysWaitsForTheProcessesOwnUser) {
  look_for(100, self);
  users.ban(self, now);
  EXPECT_FALSE(is_out(self));
}

}  // namespace
}  // namespace agnocast
