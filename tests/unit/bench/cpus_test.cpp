// SPDX-License-Identifier: Apache-2.0
//
// Goal: two pinned processes get two cores where there are two. Method: topologies as values.

#include <bench/cpus.hpp>

#include <gtest/gtest.h>

#include <map>
#include <stdexcept>

namespace agnocast::bench {
namespace {

/// Returns the choice on a machine whose CPU n is a thread of core cores[n].
Cpus chosen(const std::vector<int>& usable, const std::map<int, std::string>& cores) {
  return choose_cpus(usable, [&](int cpu) -> std::optional<std::string> {
    const auto core = cores.find(cpu);
    if (core == cores.end()) return {};
    return core->second;
  });
}

TEST(Cpus, AreOnTwoCoresWhereThereAreTwo) {
  const Cpus neighbours = chosen({0, 1, 2, 3}, {{0, "0-1"}, {1, "0-1"}, {2, "2-3"}, {3, "2-3"}});
  EXPECT_EQ(neighbours.first, 0);
  EXPECT_EQ(neighbours.second, 2);
  EXPECT_EQ(neighbours.are_siblings, false);
  const Cpus apart = chosen({4, 5}, {{4, "0,4"}, {5, "1,5"}});
  EXPECT_EQ(apart.first, 4);
  EXPECT_EQ(apart.second, 5);
  EXPECT_EQ(apart.are_siblings, false);
}

TEST(Cpus, AreThreadsOfOneCoreWhereThereIsNoOther) {
  const Cpus cpus = chosen({2, 6}, {{2, "2,6"}, {6, "2,6"}});
  EXPECT_EQ(cpus.second, 6);
  EXPECT_EQ(cpus.are_siblings, true);
}

TEST(Cpus, AreTheFirstTwoWhereTheCoresAreUnknown) {
  const Cpus cpus = chosen({3, 7, 8}, {});
  EXPECT_EQ(cpus.first, 3);
  EXPECT_EQ(cpus.second, 7);
  EXPECT_FALSE(cpus.are_siblings.has_value());
  EXPECT_TRUE(cpus.has_two());
}

TEST(Cpus, MayBeOne) {
  const Cpus cpus = chosen({5}, {{5, "5"}});
  EXPECT_EQ(cpus.first, 5);
  EXPECT_FALSE(cpus.has_two() || cpus.are_siblings.has_value());
  EXPECT_THROW((void)chosen({}, {}), std::out_of_range);
}

}  // namespace
}  // namespace agnocast::bench
