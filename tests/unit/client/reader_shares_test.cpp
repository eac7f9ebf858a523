// SPDX-License-Identifier: Apache-2.0

#include <client/reader_shares.hpp>

#include <gtest/gtest.h>

#include <vector>

namespace agnocast {
namespace {

using namespace std::chrono_literals;

struct ReaderSharesTest : testing::Test {
  static constexpr std::uint64_t heap = 1000;
  ReaderShares shares;
  ReaderShares::Clock::time_point now{1h};
  std::uint64_t refused = 0;

  /// A look a second for so long, in a heap that refuses each time.
  std::optional<std::uint32_t> full_for(int seconds, const std::vector<ReaderShares::Held>& users) {
    std::optional<std::uint32_t> whom;
    for (int i = 0; i < seconds && !whom; ++i, now += 1s)
      whom = shares.look(now, ++refused, heap, users);
    return whom;
  }
};

TEST_F(ReaderSharesTest, LeavesEverybodyAloneWhileThereIsRoom) {
  for (int i = 0; i < 60; ++i, now += 1s)
    EXPECT_FALSE(shares.look(now, refused, heap, std::vector<ReaderShares::Held>{{1, 900}}));
}

TEST_F(ReaderSharesTest, WithdrawsFromWhoHoldsAQuarterOfAFullHeap) {
  EXPECT_FALSE(full_for(60, {{1, 249}}));
  EXPECT_FALSE(full_for(5, {{1, 250}, {2, 100}})) << "it has a few seconds";
  EXPECT_EQ(full_for(1, {{1, 250}, {2, 100}}), 1u);
}

TEST_F(ReaderSharesTest, WithdrawsFromWhoHoldsMostWhereAllTogetherHoldHalf) {
  EXPECT_FALSE(full_for(60, {{1, 160}, {2, 170}, {3, 169}}));
  EXPECT_EQ(full_for(60, {{1, 160}, {2, 171}, {3, 169}}), 2u);
}

TEST_F(ReaderSharesTest, WaitsForThoseThatTryRarely) {
  const std::vector<ReaderShares::Held> users{{1, 500}};
  EXPECT_FALSE(shares.look(now, ++refused, heap, users));
  for (int i = 0; i < 60; ++i, now += 1s)
    EXPECT_FALSE(shares.look(now, refused, heap, users)) << "nothing was refused since";
  EXPECT_EQ(shares.look(now, ++refused, heap, users), 1u);
}

TEST_F(ReaderSharesTest, BeginsAnewOnceNobodyIsOverItsShare) {
  EXPECT_FALSE(full_for(5, {{1, 500}}));
  EXPECT_FALSE(full_for(1, {{1, 5}}));
  EXPECT_FALSE(full_for(5, {{1, 500}}));
  EXPECT_EQ(full_for(1, {{1, 500}}), 1u);
  shares.nobody_holds();
  EXPECT_FALSE(full_for(5, {{1, 500}}));
}

TEST_F(ReaderSharesTest, KeepsNewcomersOfThatUserOutForAWhile) {
  ASSERT_EQ(full_for(60, {{1, 500}}), 1u);
  EXPECT_TRUE(shares.is_out(1, now));
  EXPECT_FALSE(shares.is_out(2, now));
  EXPECT_FALSE(shares.is_out(1, now + ReaderShares::out_for));
}

}  // namespace
}  // namespace agnocast
