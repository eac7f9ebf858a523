// SPDX-License-Identifier: Apache-2.0
//
// Goal: the arena fits into every supported machine, and an arena that does not fit is refused;
// windows are assigned lowest first and never twice. Method: numbers in, numbers out.

#include <agnocast/abi/limits.hpp>
#include <daemon/state/address_plan.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <optional>
#include <random>
#include <set>
#include <span>
#include <vector>

namespace agnocast::daemon {
namespace {

constexpr std::uint64_t gib = std::uint64_t{1} << 30;

/// Returns where the next window is, if there is one.
std::optional<std::uint64_t> taken(AddressPlan& plan, std::span<const Obstacle> obstacles = {}) {
  const auto choice = plan.take(obstacles);
  if (!choice) return std::nullopt;
  return choice->base;
}

TEST(AddressPlan, BeginsInTheNextEighthAfterEachDaemonAndWrapsAround) {
  const Arena arena{0x1000000, 16 * 0x1000, 0x1000};
  for (std::uint64_t former : {0u, 1u, 7u, 8u, 1000u}) {
    AddressPlan plan(arena, former);
    for (std::uint64_t i = 0; i < 16; ++i)
      EXPECT_EQ(taken(plan), arena.base + (former % 8 * 2 + i) % 16 * 0x1000) << former;
    EXPECT_EQ(taken(plan), std::nullopt);
  }
}

TEST(AddressPlan, PrefersAnEmptyPlaceToItsBeginning) {
  const Arena arena{0x1000000, 16 * 0x1000, 0x1000};
  AddressPlan plan(arena, 4);
  const Obstacle upper[] = {{arena.base + 8 * 0x1000, 8 * 0x1000, 1}};
  EXPECT_EQ(taken(plan, upper), arena.base);
}

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

// AArch64 kernels with 39, 42, 47 (with 16 KiB pages) and 48 bits, x86-64 with 47.
TEST(AddressPlan, FitsSmallAddressSpacesWithUsefulWindows) {
  struct Machine {
    unsigned bits;
    std::uint64_t memory;
    Arena arena;
  };
  const Machine machines[] = {
      {39, gib, {128 * gib, 32 * gib, gib / 4}},
      {39, 4 * gib, {128 * gib, 32 * gib, gib / 2}},
      {39, 64 * gib, {128 * gib, 32 * gib, gib / 2}},  // at least 64 processes get a window
      {42, 8 * gib, {1024 * gib, 256 * gib, 2 * gib}},
      {42, 64 * gib, {1024 * gib, 256 * gib, 4 * gib}},
      {47, gib / 2, {0x2000'0000'0000, 8192 * gib, gib / 8}},
      {48, 64 * gib, {0x2000'0000'0000, 8192 * gib, 16 * gib}},
  };
  for (const Machine& machine : machines) {
    const auto arena = plan_arena({}, machine.bits, machine.memory);
    ASSERT_TRUE(arena) << machine.bits;
    EXPECT_EQ(arena->base, machine.arena.base) << machine.bits;
    EXPECT_EQ(arena->bytes, machine.arena.bytes) << machine.bits;
    EXPECT_EQ(arena->window_bytes, machine.arena.window_bytes)
        << machine.bits << " bits, " << machine.memory;
    AddressPlan plan(*arena);
    EXPECT_GE(plan.window_count(), 64u) << machine.bits;
    for (int i = 0; i < 64; ++i) {
      const auto base = taken(plan);
      ASSERT_TRUE(base) << machine.bits;
      EXPECT_LE(*base + arena->window_bytes, std::uint64_t{1} << machine.bits);
    }
  }
}

TEST(AddressPlan, TheConfigurationMayGiveASmallerArena) {
  // The case of a container with ulimit -v: as much as 16 processes of 64 MiB need.
  const auto arena = plan_arena({128 * gib, gib, 64 << 20}, 39, 2 * gib);
  ASSERT_TRUE(arena);
  EXPECT_EQ(AddressPlan(*arena).window_count(), 16u);
  EXPECT_FALSE(plan_arena({512 * gib, gib, 64 << 20}, 39, 2 * gib))
      << "begins above the last address";
  EXPECT_FALSE(plan_arena({511 * gib, 2 * gib, 64 << 20}, 39, 2 * gib))
      << "ends above the last address";
}

TEST(AddressPlan, RefusesAnArenaThatDoesNotFit) {
  EXPECT_FALSE(plan_arena({0x7000'0000'0000, 32768 * gib, 0}, 47, 8 * gib));  // beyond the end
  EXPECT_FALSE(plan_arena({0x2000'0000'0000, ~std::uint64_t{0} - 4095, 0}, 47, 8 * gib));
  EXPECT_FALSE(plan_arena({0x2000'0000'1000, 0, 0}, 47, 8 * gib));   // base not on a huge page
  EXPECT_FALSE(plan_arena({0, 0, (64 << 20) + 4096}, 47, 8 * gib));  // not whole huge pages
  EXPECT_FALSE(plan_arena({0, gib, 2 * gib}, 47, 8 * gib));          // no window fits
  EXPECT_FALSE(plan_arena({}, 16, gib));
}

TEST(AddressPlan, GivesOutTheLowestFreeWindow) {
  AddressPlan plan({0x10000, 4 * 0x1000, 0x1000});
  EXPECT_EQ(taken(plan), 0x10000u);
  EXPECT_EQ(taken(plan), 0x11000u);
  EXPECT_EQ(taken(plan), 0x12000u);
  EXPECT_TRUE(plan.give_back(0x11000));
  EXPECT_TRUE(plan.give_back(0x10000));
  EXPECT_EQ(taken(plan), 0x10000u);
  EXPECT_EQ(taken(plan), 0x11000u);
  EXPECT_EQ(taken(plan), 0x13000u);
  EXPECT_EQ(taken(plan), std::nullopt);
}

TEST(AddressPlan, TakesBackOnlyAssignedWindows) {
  AddressPlan plan({0x10000, 4 * 0x1000, 0x1000});
  ASSERT_EQ(taken(plan), 0x10000u);
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

TEST(AddressPlan, TakesTheLowestWindowWithoutObstacles) {
  AddressPlan plan({0x10000, 8 * 0x1000, 0x1000});
  // A partly blocked window counts as blocked: 0x10000, 0x12000 and 0x13000 are avoided.
  const Obstacle obstacles[] = {{0x10fff, 1}, {0x12800, 0x1000}};
  EXPECT_EQ(taken(plan, obstacles), 0x11000u);
  EXPECT_EQ(taken(plan, obstacles), 0x14000u);
  EXPECT_EQ(taken(plan), 0x10000u) << "a process without obstacles";
  EXPECT_EQ(taken(plan, obstacles), 0x15000u);
}

TEST(AddressPlan, TakesTheWindowFreeInMostProcessesIfNoneIsFreeInAll) {
  AddressPlan plan({0x10000, 4 * 0x1000, 0x1000});
  const Obstacle obstacles[] = {
      {0x10000, 0x4000, 1}, {0x10000, 0x1000, 5}, {0x11000, 0x1000, 2}, {0x13000, 0x1000, 1}};
  EXPECT_EQ(plan.best(obstacles), (AddressPlan::Choice{0x12000, 1}));
  EXPECT_EQ(plan.best(obstacles), (AddressPlan::Choice{0x12000, 1})) << "best() assigns nothing";
  EXPECT_EQ(plan.take(obstacles), (AddressPlan::Choice{0x12000, 1}));
  EXPECT_EQ(plan.take(obstacles), (AddressPlan::Choice{0x13000, 2}));
  EXPECT_EQ(plan.take(obstacles), (AddressPlan::Choice{0x11000, 3}));
  EXPECT_EQ(plan.take(obstacles), (AddressPlan::Choice{0x10000, 6}));
  EXPECT_EQ(plan.take(obstacles), std::nullopt);
}

TEST(AddressPlan, NeverTakesAForbiddenWindow) {
  AddressPlan plan({0x10000, 4 * 0x1000, 0x1000});
  const Obstacle obstacles[] = {{0x10000, 0x2000, Obstacle::forbids},
                                {0x11000, 0x2000, Obstacle::forbids},
                                {0x13000, 0x1000, ~std::uint64_t{0} - 1}};
  EXPECT_EQ(taken(plan, obstacles), 0x13000u);
  EXPECT_EQ(taken(plan, obstacles), std::nullopt);
  EXPECT_EQ(plan.used_count(), 1u);
}

// Compared with a count window by window.
TEST(AddressPlan, ChoosesLikeACountForAnyObstacles) {
  std::mt19937 random(11);
  for (int round = 0; round < 2000; ++round) {
    const Arena arena{0x10000, 32 * 0x1000, 0x1000};
    AddressPlan plan(arena);
    std::set<std::uint64_t> used;
    for (int i = 0; i < 16; ++i) {
      const std::uint64_t base = arena.base + random() % 32 * 0x1000;
      if (plan.adopt(base)) used.insert(base);
    }
    std::vector<Obstacle> obstacles(random() % 6);
    for (Obstacle& obstacle : obstacles) {
      obstacle = {0xf000 + random() % 0x22000, 1 + random() % 0x6000, 1 + random() % 3};
      if (random() % 4 == 0) obstacle.weight = Obstacle::forbids;
    }
    std::optional<AddressPlan::Choice> expected;
    for (std::uint64_t base = arena.base; base < arena.base + arena.bytes; base += 0x1000) {
      std::uint64_t weight = 0;
      bool forbidden = used.count(base) != 0;
      for (const Obstacle& obstacle : obstacles) {
        if (obstacle.base >= base + 0x1000 || obstacle.base + obstacle.bytes <= base) continue;
        if (obstacle.weight == Obstacle::forbids) {
          forbidden = true;
        } else {
          weight += obstacle.weight;
        }
      }
      if (!forbidden && (!expected || weight < expected->weight)) expected = {base, weight};
    }
    ASSERT_EQ(plan.best(obstacles), expected) << "round " << round;
  }
}

TEST(AddressPlan, NeverGivesAWindowTwice) {
  AddressPlan plan({0x10000, 64 * 0x1000, 0x1000});
  std::mt19937 random(7);
  std::set<std::uint64_t> mine;
  for (int i = 0; i < 20000; ++i) {
    if (random() % 2 == 0) {
      if (const auto base = taken(plan)) {
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
