// SPDX-License-Identifier: Apache-2.0

#include <bridge/plan/plan_pace.hpp>

#include <gtest/gtest.h>

namespace agnocast::bridge {
namespace {

using namespace std::chrono_literals;

constexpr PlanPace::Time start{100s};

TEST(PlanPace, PlansAtOnceWhereNoPlanIsRecent) {
  PlanPace pace;
  EXPECT_FALSE(pace.is_due(start)) << "nothing has changed yet";
  EXPECT_FALSE(pace.due());
  pace.changed();
  EXPECT_TRUE(pace.is_due(start));
  pace.made(start, start + 10ms);
  EXPECT_FALSE(pace.is_owed());
  EXPECT_FALSE(pace.is_due(start + 1h));
  pace.changed();
  EXPECT_TRUE(pace.is_due(start + 1h));
}

TEST(PlanPace, TakesAFifthOfTheTimeHoweverFrequentTheChanges) {
  PlanPace pace;
  PlanPace::Time now = start;
  std::chrono::milliseconds planned{0};
  while (now < start + 10s) {
    pace.changed();
    if (pace.is_due(now)) {
      pace.made(now, now + 20ms);
      now += 20ms;
      planned += 20ms;
    } else {
      now += 1ms;
    }
  }
  EXPECT_EQ(planned, 2s);
}

TEST(PlanPace, DelaysAPlanByAtMostASecond) {
  PlanPace pace;
  pace.made(start, start + 5s);
  pace.changed();
  EXPECT_EQ(pace.due(), start + 6s);
  EXPECT_FALSE(pace.is_due(start + 5999ms));
  EXPECT_TRUE(pace.is_due(start + 6s));
}

TEST(PlanPace, OwesAPostponedPlan) {
  PlanPace pace;
  pace.changed();
  pace.put_off(start + 1s);
  EXPECT_TRUE(pace.is_owed());
  EXPECT_FALSE(pace.is_due(start));
  EXPECT_TRUE(pace.is_due(start + 1s));
}

}  // namespace
}  // namespace agnocast::bridge
