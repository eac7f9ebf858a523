// SPDX-License-Identifier: Apache-2.0
//
// Goal: a range that a process cannot map restricts that process and the choice of new windows; no
// user can have the whole arena avoided. Method: claims in, obstacles and choices out.

#include <agnocast/abi/limits.hpp>
#include <daemon/state/obstacles.hpp>

#include <gtest/gtest.h>

namespace agnocast::daemon {
namespace {

constexpr std::uint64_t window = 0x40'0000;
constexpr Arena arena{0x1000'0000, 16 * window, window};
constexpr ClientIndex mine{3}, other{4}, third{5};

std::uint64_t base_of(std::uint64_t number) { return arena.base + number * window; }
WindowRecord record_of(std::uint64_t number) { return {base_of(number), window, 0}; }

/// Returns the window that `client` would get.
std::optional<std::uint64_t> choice_of(const Obstacles& obstacles, ClientIndex client) {
  const auto choice = AddressPlan(arena).best(obstacles.against(client));
  if (!choice) return std::nullopt;
  return (choice->base - arena.base) / window;
}

TEST(Obstacles, AClaimKeepsAllProcessesFromTheWindowsThatItTouches) {
  Obstacles obstacles(arena);
  ASSERT_TRUE(obstacles.add(mine, 1000, base_of(0) + window / 2, window, "a JIT"));
  EXPECT_EQ(choice_of(obstacles, mine), 2u);
  EXPECT_EQ(choice_of(obstacles, other), 2u);
  const auto* const claim = obstacles.in_the_way(mine, record_of(1));
  ASSERT_NE(claim, nullptr);
  EXPECT_EQ(claim->what, "a JIT");
  EXPECT_EQ(obstacles.in_the_way(mine, record_of(2)), nullptr);
  EXPECT_EQ(obstacles.in_the_way(other, record_of(1)), nullptr) << "others can map it";
  obstacles.forget(mine);
  EXPECT_EQ(choice_of(obstacles, other), 0u);
  EXPECT_EQ(obstacles.in_the_way(mine, record_of(1)), nullptr);
}

TEST(Obstacles, RefusesRangesOutsideTheArenaAndTooMany) {
  Obstacles obstacles(arena);
  const std::uint64_t end = arena.base + arena.bytes;
  EXPECT_FALSE(obstacles.add(mine, 1000, arena.base - 1, 2, ""));
  EXPECT_FALSE(obstacles.add(mine, 1000, end - 1, 2, ""));
  EXPECT_FALSE(obstacles.add(mine, 1000, end, 1, ""));
  EXPECT_FALSE(obstacles.add(mine, 1000, arena.base, 0, ""));
  EXPECT_FALSE(obstacles.add(mine, 1000, ~std::uint64_t{0}, ~std::uint64_t{0}, ""));
  for (std::uint64_t i = 0; i < abi::blocked_count_max; ++i)
    ASSERT_TRUE(obstacles.add(mine, 1000, base_of(0) + i, 1, "")) << i;
  EXPECT_FALSE(obstacles.add(mine, 1000, base_of(3), 1, ""));
  EXPECT_TRUE(obstacles.add(mine, 1000, base_of(0), 1, ""))
      << "a repeated claim after a reconnection";
  EXPECT_EQ(obstacles.of(mine).size(), abi::blocked_count_max);
}

TEST(Obstacles, AUserCannotHaveMoreThanHalfOfTheArenaAvoided) {
  Obstacles obstacles(arena);
  ASSERT_TRUE(obstacles.add(mine, 1000, base_of(0), 5 * window, ""));
  ASSERT_TRUE(obstacles.add(other, 1000, base_of(4), 4 * window, "")) << "window 4 counts once";
  EXPECT_EQ(choice_of(obstacles, third), 8u);
  ASSERT_TRUE(obstacles.add(mine, 1000, base_of(8), 8 * window, "all of it"));
  EXPECT_EQ(choice_of(obstacles, third), 8u) << "claims beyond the half restrict no other process";
  EXPECT_EQ(choice_of(obstacles, mine), 5u) << "but the process itself";
  EXPECT_FALSE(obstacles.in_the_way(mine, record_of(9))->counts);
  // Another user has a half of its own; then some process gets a window that another cannot map.
  ASSERT_TRUE(obstacles.add(ClientIndex{6}, 1001, base_of(8), 8 * window, ""));
  EXPECT_TRUE(choice_of(obstacles, third).has_value());
}

TEST(Obstacles, AUserHasABoundedNumberOfDifferentRanges) {
  Obstacles obstacles({0x1000'0000, 4096 * window, window});
  const auto range = [](std::uint64_t i) { return arena.base + 2 * i * window; };
  for (std::uint32_t i = 0; i < Obstacles::ranges_per_user_max; ++i)
    ASSERT_TRUE(obstacles.add(ClientIndex{i}, 1000, range(i), 1, ""));
  ASSERT_TRUE(obstacles.add(ClientIndex{100}, 1000, range(0), 1, "the same library"));
  EXPECT_TRUE(obstacles.of(ClientIndex{100}).front().counts);
  ASSERT_TRUE(obstacles.add(ClientIndex{100}, 1000, range(100), 1, ""));
  EXPECT_FALSE(obstacles.of(ClientIndex{100}).back().counts);
  ASSERT_TRUE(obstacles.add(ClientIndex{101}, 1001, range(100), 1, "another user's"));
  EXPECT_TRUE(obstacles.of(ClientIndex{101}).back().counts);
}

TEST(Obstacles, UncountedClaimsEndWithTheirProcesses) {
  Obstacles obstacles(arena);
  for (const ClientIndex client : {mine, other}) {
    ASSERT_TRUE(obstacles.add(client, 1000, base_of(0), arena.bytes, "everything"));
    EXPECT_FALSE(obstacles.of(client).front().counts);
  }
  EXPECT_EQ(choice_of(obstacles, mine), std::nullopt);
  obstacles.forget(mine);
  obstacles.forget(other);
  EXPECT_EQ(choice_of(obstacles, mine), 0u);
}

TEST(Obstacles, AMoreCrowdedWindowIsAvoidedMore) {
  Obstacles obstacles(arena);
  ASSERT_TRUE(obstacles.add(mine, 1000, base_of(0), 8 * window, ""));
  ASSERT_TRUE(obstacles.add(other, 1001, base_of(8), 8 * window, ""));
  ASSERT_TRUE(obstacles.add(third, 1002, base_of(0), 3 * window, ""));
  EXPECT_EQ(choice_of(obstacles, ClientIndex{9}), 3u);
}

}  // namespace
}  // namespace agnocast::daemon
