// SPDX-License-Identifier: Apache-2.0

#include <bridge/outward/source_times.hpp>

#include <gtest/gtest.h>

namespace agnocast::bridge {
namespace {

TEST(SourceTimes, RiseWhereTheOffsetOfTheClocksIsInexact) {
  SourceTimes times;
  EXPECT_EQ(times.next(5'000'000'000), 5'000'000'000);
  EXPECT_EQ(times.next(5'000'000'000), 5'000'000'001);
  EXPECT_EQ(times.next(4'999'000'000), 5'000'000'002);
  EXPECT_EQ(times.next(5'000'000'010), 5'000'000'010);
}

TEST(SourceTimes, FollowAClockThatWasSetBack) {
  SourceTimes times;
  EXPECT_EQ(times.next(5'000'000'000), 5'000'000'000);
  EXPECT_EQ(times.next(5'000'000'000 - SourceTimes::inexact_max_ns),
            5'000'000'000 - SourceTimes::inexact_max_ns);
}

}  // namespace
}  // namespace agnocast::bridge
