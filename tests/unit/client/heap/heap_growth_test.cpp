// SPDX-License-Identifier: Apache-2.0

#include <client/heap/heap_growth.hpp>

#include <gtest/gtest.h>

namespace agnocast {
namespace {

using namespace std::chrono_literals;

struct HeapGrowthTest : testing::Test {
  HeapGrowth growth;
  HeapGrowth::Clock::time_point now{1h};

  bool is_asked_for(bool wants) const { return growth.may_ask() && growth.is_due(now, wants); }
};

TEST_F(HeapGrowthTest, AsksForAWantedWindowOneAtATime) {
  EXPECT_FALSE(is_asked_for(false));
  ASSERT_TRUE(is_asked_for(true));
  growth.asked();
  EXPECT_FALSE(is_asked_for(true));
  EXPECT_FALSE(growth.opened());
  EXPECT_EQ(growth.window_count(), 2u);
  EXPECT_TRUE(is_asked_for(true));
}

TEST_F(HeapGrowthTest, AsksAgainWhenThereWasNoMemoryToAsk) {
  growth.asked();
  growth.not_asked();
  EXPECT_TRUE(is_asked_for(true));
  EXPECT_FALSE(growth.is_refused());
}

TEST_F(HeapGrowthTest, AsksLessAndLessOftenAfterRefusalsAndAtOnceAfterASuccess) {
  auto pause = HeapGrowth::pause_first;
  for (int refusals = 0; refusals < 10; ++refusals) {
    growth.asked();
    growth.refused(now);
    EXPECT_TRUE(growth.is_refused());
    now += pause - 1ms;
    EXPECT_FALSE(is_asked_for(true)) << refusals;
    now += 1ms;
    EXPECT_TRUE(is_asked_for(true)) << refusals;
    pause = std::min(pause * 2, HeapGrowth::pause_last);
  }
  EXPECT_EQ(pause, HeapGrowth::pause_last);
  growth.asked();
  EXPECT_FALSE(growth.opened());
  EXPECT_FALSE(growth.is_refused());
  EXPECT_TRUE(is_asked_for(true));
  growth.asked();
  growth.refused(now);
  now += HeapGrowth::pause_first;
  EXPECT_TRUE(is_asked_for(true)) << "the pause is short again";
}

TEST_F(HeapGrowthTest, ContinuesInTheWindowThatTheDaemonRequests) {
  growth.move_to(1);
  EXPECT_TRUE(is_asked_for(false));
  growth.asked();
  EXPECT_FALSE(growth.opened());
  EXPECT_FALSE(is_asked_for(false));
}

TEST_F(HeapGrowthTest, DoesNotGrowBeforeItIsPermitted) {
  growth.hold_back();
  growth.bring(3);
  EXPECT_EQ(growth.window_count(), 3u);
  EXPECT_FALSE(is_asked_for(true));
  EXPECT_TRUE(growth.permit());
  EXPECT_FALSE(growth.permit());
  EXPECT_TRUE(is_asked_for(true));
}

TEST_F(HeapGrowthTest, SaysWhichWindowIsTheLastOne) {
  growth.bring(abi::window_count_max - 1);
  growth.asked();
  EXPECT_TRUE(growth.opened());
}

}  // namespace
}  // namespace agnocast
