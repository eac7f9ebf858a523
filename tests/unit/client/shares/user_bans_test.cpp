// SPDX-License-Identifier: Apache-2.0

#include <client/shares/user_bans.hpp>

#include <gtest/gtest.h>

namespace agnocast {
namespace {

using namespace std::chrono_literals;

constexpr PeerOwner somebody{7, false}, somebody_else{8, false};

TEST(UserBans, EndAfterAWhile) {
  UserBans bans;
  const UserBans::Clock::time_point now{1h};
  EXPECT_FALSE(bans.has(somebody, now));
  bans.add(somebody, now);
  EXPECT_TRUE(bans.has(somebody, now));
  EXPECT_TRUE(bans.has(somebody, now + UserBans::first - 1s));
  EXPECT_FALSE(bans.has(somebody, now + UserBans::first));
  EXPECT_FALSE(bans.has(somebody_else, now));
}

TEST(UserBans, GetLongerEachTimeUpToALimit) {
  UserBans bans;
  UserBans::Clock::time_point now{1h};
  for (std::chrono::seconds length = UserBans::first; length < 10 * UserBans::longest;
       length *= 2) {
    const std::chrono::seconds bounded = std::min(length, UserBans::longest);
    bans.add(somebody, now);
    EXPECT_TRUE(bans.has(somebody, now + bounded - 1s));
    EXPECT_FALSE(bans.has(somebody, now + bounded));
    now += bounded + UserBans::longest - 1s;
  }
}

TEST(UserBans, AreForgottenAfterALongTime) {
  UserBans bans;
  UserBans::Clock::time_point now{1h};
  bans.add(somebody, now);
  bans.add(somebody, now);
  EXPECT_TRUE(bans.has(somebody, now + UserBans::first)) << "the second ban is twice as long";
  now += 2 * UserBans::first + UserBans::longest;
  bans.add(somebody, now);
  EXPECT_FALSE(bans.has(somebody, now + UserBans::first));
}

// The same uid in another user namespace is another user.
TEST(UserBans, NeverApplyToTheOwnUser) {
  UserBans bans;
  const UserBans::Clock::time_point now{1h};
  bans.add({7, true}, now);
  EXPECT_FALSE(bans.has({7, false}, now));
  bans.add({7, false}, now);
  EXPECT_TRUE(bans.has({7, false}, now));
  EXPECT_FALSE(bans.has({7, true}, now));
}

}  // namespace
}  // namespace agnocast
