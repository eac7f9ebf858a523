// SPDX-License-Identifier: Apache-2.0
//
// Goal: the arena fits into every machine it is planned for and refuses what does not; windows are
// given out lowest first and never twice. Method: numbers in, numbers out.

#include <agnocast/abi/limits.hpp>
#include <daemon/address_plan.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <set>

namespace agnocast::daemon {
namespace {

constexpr std::uint64_t gib = std::uint64_t{1} << 30;

TEST(AddressPlan, TakesTheDefaultOnAServer) {
  const auto arena = plan_arena({}, 47, 64 * gib);
  ASSERT_TRUE(arena);
  EXPECT_EQ(arena->base, 0x200000000000u);
  EXPECT_EQ(arena->bytes, 8192 * gib);
  EXPECT_EQ(arena->window_bytes, 16 * gib);
}

TEST(AddressPlan, GivesAWindowAQuarterOfASmallMemory) {
  const auto arena = plan_arena({}, 47, 8 * gib);
  ASSERT_TRUE(arena);
  EXPECT_EQ(arena->window_bytes, 2 * gib);
}

TEST(AddressPlan, FitsEveryNumberOfAddressBitsAndEveryMemory) {
  for (unsigned bits = 36; bits <= 56; ++bits) {
    for (std::uint64_t memory : {std::uint64_t{0}, gib / 4, gib, 3 * gib + 123, 1000 * gib}) {
      const auto arena = plan_arena({}, bits, memory);
      ASSERT_TRUE(arena) << bits;
      EXPECT_LE(arena->base + arena->bytes, std::uint64_t{1} << bits) << bits;
      EXPECT_GE(arena->base, std::min(std::uint64_t{1} << (bits - 2), 0x200000000000u)) << bits;
      EXPECT_EQ(arena->window_bytes % abi::window_granule_bytes, 0u);
      EXPECT_EQ(arena->base % abi::window_granule_bytes, 0u);
      EXPECT_GE(arena->bytes / arena->window_bytes, 64u) << bits << " bits, " << memory;
    }
  }
}

TEST(AddressPlan, RefusesWhatDoesNotFit) {
  EXPECT_FALSE(plan_arena({0x7000'0000'0000, 32768 * gib, 0}, 47, 8 * gib));  // over the end
  EXPECT_FALSE(plan_arena({0x2000'0000'0000, ~std::uint64_t{0} - 4095, 0}, 47, 8 * gib));
  EXPECT_FALSE(plan_arena({0x2000'0000'1000, 0, 0}, 47, 8 * gib));   // not a huge page
  EXPECT_FALSE(plan_arena({0, 0, (64 << 20) + 4096}, 47, 8 * gib));  // not huge pages
  EXPECT_FALSE(plan_arena({0, gib, 2 * gib}, 47, 8 * gib));          // no window fits
  EXPECT_FALSE(plan_arena({}, 16, gib));
}

TEST(AddressPlan, GivesOutTheLowestFreeWindow) {
  AddressPlan plan({0x10000, 4 * 0x1000, 0x1000});
  EXPECT_EQ(plan.take(), 0x10000u);
  EXPECT_EQ(plan.take(), 0x11000u);
  EXPECT_EQ(plan.take(), 0x12000u);
  EXPECT_TRUE(plan.give_back(0x11000));
  EXPECT_TRUE(plan.give_back(0x10000));
  EXPECT_EQ(plan.take(), 0x10000u);
  EXPECT_EQ(plan.take(), 0x11000u);
  EXPECT_EQ(plan.take(), 0x13000u);
  EXPECT_EQ(plan.take(), std::nullopt);
}

TEST(AddressPlan, TakesBackOnlyWhatItGave) {
  AddressPlan plan({0x10000, 4 * 0x1000, 0x1000});
  ASSERT_EQ(plan.take(), 0x10000u);
  EXPECT_FALSE(plan.give_back(0x11000));
  EXPECT_FALSE(plan.give_back(0x10001));
  EXPECT_FALSE(plan.give_back(0xf000));
  EXPECT_TRUE(plan.give_back(0x10000));
  EXPECT_FALSE(plan.give_back(0x10000));
  EXPECT_TRUE(plan.adopt(0x12000));
  EXPECT_FALSE(plan.adopt(0x12000));
  EXPECT_FALSE(plan.adopt(0x14000));  // behind the end
  EXPECT_EQ(plan.used_count(), 1u);
}

TEST(AddressPlan, NeverGivesAWindowTwice) {
  AddressPlan plan({0x10000, 64 * 0x1000, 0x1000});
  std::mt19937 random(7);
  std::set<std::uint64_t> mine;
  for (int i = 0; i < 20000; ++i) {
    if (random() % 2 == 0) {
      if (const auto base = plan.take()) {
        ASSERT_TRUE(mine.insert(*base).second);
      } else {
        ASSERT_EQ(mine.size(), 64u);
      }
    } else if (!mine.empty()) {
      auto at = mine.begin();
      std::advance(at, random() % mine.size());
      ASSERT_TRUE(plan.give_back(*at));
      mine.erase(at);
    }
    ASSERT_EQ(plan.used_count(), mine.size());
  }
}

}  // namespace
}  // namespace agnocast::daemon
