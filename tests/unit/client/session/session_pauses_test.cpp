// SPDX-License-Identifier: Apache-2.0
//
// Goal: the control thread looks, and asks again, at the intervals of scan_timer.hpp and
// reannouncement.hpp.

#include <client/connection/reannouncement.hpp>
#include <client/upkeep/scan_timer.hpp>

#include <gtest/gtest.h>

#include <vector>

namespace agnocast {
namespace {

using namespace std::chrono_literals;

TEST(ScanTimer, LooksSoonAfterAPublishAndThenLessAndLessOften) {
  ScanTimer timer;
  EXPECT_EQ(timer.next_ms(false, false, false), ScanTimer::last_ms);
  std::vector<int> pauses;
  for (int i = 0; i < 6; ++i) pauses.push_back(timer.next_ms(true, false, false));
  EXPECT_EQ(pauses, (std::vector<int>{100, 200, 400, 800, 1000, 1000}));
  EXPECT_EQ(timer.next_ms(false, false, false), ScanTimer::last_ms);
  EXPECT_EQ(timer.next_ms(true, false, false), ScanTimer::first_ms);
}

TEST(ScanTimer, LooksForALinkSooner) {
  ScanTimer timer;
  EXPECT_EQ(timer.next_ms(false, false, false), ScanTimer::last_ms);
  std::vector<int> pauses;
  for (int i = 0; i < 9; ++i) pauses.push_back(timer.next_ms(false, true, false));
  EXPECT_EQ(pauses, (std::vector<int>{1, 2, 4, 8, 16, 32, 64, 100, 100}));
  EXPECT_EQ(timer.next_ms(false, false, false), ScanTimer::last_ms);
  EXPECT_EQ(timer.next_ms(false, true, false), ScanTimer::link_first_ms);
}

TEST(ScanTimer, LooksAtAConstantIntervalWithoutADaemon) {
  ScanTimer timer;
  for (const bool reclaimable : {false, true})
    EXPECT_EQ(timer.next_ms(reclaimable, true, true), ScanTimer::alone_ms);
}

struct ReannouncementTest : testing::Test {
  Reannouncement again;
  Reannouncement::Clock::time_point now{1h};

  std::chrono::milliseconds wait() {
    const auto from = now;
    while (!again.is_due(now)) now += 100ms;
    return std::chrono::duration_cast<std::chrono::milliseconds>(now - from);
  }
};

TEST_F(ReannouncementTest, DoublesThePauseEachTimeDescriptorsAreLost) {
  EXPECT_FALSE(again.is_awaited());
  for (const auto pause : {1s, 2s, 4s, 8s, 16s, 30s, 30s}) {
    again.lost(now);
    again.lost(now + 1ms);  // on the same connection
    EXPECT_TRUE(again.is_awaited());
    EXPECT_EQ(wait(), pause);
    again.begun();
    EXPECT_FALSE(again.is_awaited());
  }
  now += 2 * Reannouncement::pause_last + 1s;
  again.lost(now);
  EXPECT_EQ(wait(), Reannouncement::pause_first);
}

TEST_F(ReannouncementTest, WaitsForDescriptors) {
  again.lost(now);
  wait();
  again.postpone(now);
  EXPECT_FALSE(again.is_due(now));
  EXPECT_EQ(wait(), Reannouncement::pause_first);
}

TEST_F(ReannouncementTest, LooksForLargerSharesOnceASecondAndAsksForThemMoreRarely) {
  ASSERT_TRUE(again.may_look(now));
  again.looked(now);
  EXPECT_FALSE(again.may_look(now));
  now += Reannouncement::pause_first;
  ASSERT_TRUE(again.may_look(now));
  again.looked(now);
  again.ask(now);
  EXPECT_TRUE(again.is_due(now));
  now += Reannouncement::pause_last;
  EXPECT_FALSE(again.may_look(now)) << "while announcements are outstanding";
  again.begun();
  EXPECT_TRUE(again.may_look(now));
}

}  // namespace
}  // namespace agnocast
