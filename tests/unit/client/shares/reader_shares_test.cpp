// SPDX-License-Identifier: Apache-2.0

#include <client/shares/reader_shares.hpp>

#include <gtest/gtest.h>

#include <map>
#include <vector>

namespace agnocast {
namespace {

using namespace std::chrono_literals;

using Users = std::vector<ReaderShares::Held>;
using Shares = std::map<std::uint32_t, std::uint64_t>;

struct ReaderSharesTest : testing::Test {
  static constexpr std::uint64_t heap = 1000;
  ReaderShares shares;
  ReaderShares::Clock::time_point now{1h};
  ReaderShares::Room room{0, false, heap, 8 * heap};

  // An earlier look finds that the heap cannot grow.
  ReaderSharesTest() {
    look({});
    now += 1s;
  }

  /// Returns the users to withdraw from, by uid. No message is kept by two users.
  Shares look(const Users& users) {
    std::uint64_t together = 0;
    for (const auto& user : users) together += user.bytes;
    Shares above;
    for (const auto& one : shares.look(now, room, together, users)) above[one.uid] = one.share;
    return above;
  }
  /// Looks once a second for so long, in a heap that refuses each time.
  Shares full_for(int seconds, const Users& users) {
    Shares whom;
    for (int i = 0; i < seconds && whom.empty(); ++i, now += 1s) {
      ++room.refused;
      whom = look(users);
    }
    return whom;
  }
};

TEST_F(ReaderSharesTest, WithdrawsNoReaderWhileThereIsRoom) {
  for (int i = 0; i < 60; ++i, now += 1s) EXPECT_EQ(look({{1, 900}}), Shares{});
}

TEST_F(ReaderSharesTest, WithdrawsFromAUserThatKeepsAQuarterOfAFullHeap) {
  EXPECT_EQ(full_for(60, {{1, 250}}), Shares{});
  EXPECT_EQ(full_for(5, {{1, 251}, {2, 100}}), Shares{}) << "the user has a few seconds";
  EXPECT_EQ(full_for(1, {{1, 251}, {2, 100}}), (Shares{{1, 250}}));
}

// Its next window is under way, or comes with the next refusal.
TEST_F(ReaderSharesTest, WithdrawsNoReaderWhileTheHeapMayGrow) {
  room.may_grow = true;
  EXPECT_EQ(full_for(60, {{1, 500}}), Shares{});
  room.may_grow = false;
  EXPECT_EQ(full_for(1, {{1, 500}}), Shares{})
      << "refused before the heap was known to be unable to grow";
  for (int i = 0; i < 60; ++i, now += 1s) EXPECT_EQ(look({{1, 500}}), Shares{});
  EXPECT_EQ(full_for(5, {{1, 500}}), Shares{});
  EXPECT_EQ(full_for(1, {{1, 500}}), (Shares{{1, 250}}));
}

TEST_F(ReaderSharesTest, WithdrawsInOneLookFromAllUsersAboveTheirPartOfHalf) {
  EXPECT_EQ(full_for(60, {{1, 160}, {2, 171}, {3, 169}}), Shares{});
  EXPECT_EQ(full_for(60, {{1, 170}, {2, 171}, {3, 169}}), (Shares{{1, 166}, {2, 166}, {3, 166}}));
}

TEST_F(ReaderSharesTest, LetsOthersUseWhatSomeUsersDoNotNeed) {
  EXPECT_EQ(full_for(60, {{1, 100}, {2, 250}, {3, 1}, {4, 240}}), (Shares{{2, 199}, {4, 199}}));
}

TEST_F(ReaderSharesTest, CountsOnceMessagesThatSeveralUsersKeep) {
  const Users users{{1, 200}, {2, 200}, {3, 200}};
  for (int i = 0; i < 60; ++i, now += 1s) {
    ++room.refused;
    EXPECT_TRUE(shares.look(now, room, 200, users).empty());
  }
}

TEST_F(ReaderSharesTest, WaitsForPublishersThatTryRarely) {
  const Users users{{1, 500}};
  ++room.refused;
  EXPECT_EQ(look(users), Shares{});
  for (int i = 0; i < 60; ++i, now += 1s)
    EXPECT_EQ(look(users), Shares{}) << "no allocation was refused since";
  ++room.refused;
  EXPECT_EQ(look(users), (Shares{{1, 250}}));
}

// The system would kill a process before such a heap refuses an allocation.
TEST_F(ReaderSharesTest, DoesNotWaitForARefusalWhenReadersKeepHalfOfTheHeapsMaximum) {
  room.may_become = 800;
  for (int i = 0; i < 60; ++i, now += 1s) EXPECT_EQ(look({{1, 200}, {2, 200}}), Shares{});
  const Users users{{1, 201}, {2, 200}, {3, 10}};
  for (int i = 0; i < 5; ++i, now += 1s) EXPECT_EQ(look(users), Shares{});
  EXPECT_EQ(look(users), (Shares{{1, 195}, {2, 195}}));
}

TEST_F(ReaderSharesTest, WithdrawsFromAUserThatReleasesBrieflyAgainAndAgain) {
  Shares whom;
  for (int second = 0; second < 60 && whom.empty(); ++second, now += 1s) {
    const bool releases = second % 5 == 4;
    if (!releases) ++room.refused;
    whom = look({{1, releases ? 5u : 500u}});
  }
  EXPECT_EQ(whom, (Shares{{1, 250}}));
}

TEST_F(ReaderSharesTest, WithdrawsFromAUserWhoseReadersLeaveBrieflyAgainAndAgain) {
  EXPECT_EQ(full_for(4, {{1, 500}}), Shares{});
  shares.nobody_reads(now);
  now += 1s;
  EXPECT_EQ(full_for(2, {{1, 500}}), (Shares{{1, 250}}));
}

TEST_F(ReaderSharesTest, GivesEachUserItsOwnPatience) {
  EXPECT_EQ(full_for(5, {{1, 500}, {2, 100}}), Shares{});
  EXPECT_EQ(full_for(1, {{1, 400}, {2, 400}}), (Shares{{1, 250}}))
      << "the other is above for the first time";
  EXPECT_FALSE(shares.is_out({2, false}, now));
  EXPECT_EQ(full_for(4, {{2, 400}}), Shares{});
  EXPECT_EQ(full_for(1, {{2, 400}}), (Shares{{2, 250}}));
}

TEST_F(ReaderSharesTest, ForgivesAUserThatIsRarelyAbove) {
  for (int second = 0; second < 3600; ++second, now += 1s) {
    ++room.refused;
    EXPECT_EQ(look({{1, second % 20 == 0 ? 500u : 5u}}), Shares{}) << second;
  }
}

TEST_F(ReaderSharesTest, StartsAgainAfterAMinuteWithoutRefusal) {
  const Users users{{1, 500}};
  ++room.refused;
  for (int i = 0; i < 62; ++i, now += 1s) EXPECT_EQ(look(users), Shares{});
  EXPECT_EQ(full_for(5, users), Shares{});
  EXPECT_EQ(full_for(1, users), (Shares{{1, 250}}));
}

TEST_F(ReaderSharesTest, KeepsNewReadersOfTheseUsersOutForAWhile) {
  ASSERT_EQ(full_for(60, {{1, 300}, {2, 300}}).size(), 2u);
  for (const std::uint32_t uid : {1u, 2u}) {
    EXPECT_TRUE(shares.is_out({uid, false}, now));
    EXPECT_FALSE(shares.is_out({uid, true}, now)) << "in another user namespace";
    EXPECT_FALSE(shares.is_out({uid, false}, now + UserBans::first));
  }
  EXPECT_FALSE(shares.is_out({3, false}, now));
}

// Each user fills the heap alone as often as it is admitted.
TEST_F(ReaderSharesTest, KeepsTheHeapRarelyFullHoweverManyUsersAlternate) {
  constexpr std::uint32_t users = 12;
  int full = 0;
  for (int second = 0; second < 4 * 3600; ++second, now += 1s) {
    std::uint32_t uid = 1;
    while (uid <= users && shares.is_out({uid, false}, now)) ++uid;
    if (uid > users) {
      shares.nobody_reads(now);
      continue;
    }
    ++full;
    ++room.refused;
    (void)look({{uid, 900}});
  }
  // In four hours: seven bans from 60 s to an hour, then one an hour, each after six seconds.
  EXPECT_LE(full, static_cast<int>(users) * 10 * 6);
  EXPECT_GE(full, static_cast<int>(users) * 6);
}

}  // namespace
}  // namespace agnocast
