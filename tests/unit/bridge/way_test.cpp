// SPDX-License-Identifier: Apache-2.0

#include <bridge/inward/way.hpp>

#include <gtest/gtest.h>

namespace agnocast::bridge {
namespace {

using namespace std::chrono_literals;

constexpr Time start{100s};

ReaderKey inlet(std::size_t depth) {
  return {{{"/chatter", "std_msgs/msg/String"}, {}}, depth, false};
}

TEST(Way, TakesWhatComesByItsInletAlone) {
  Way way(inlet(1));
  EXPECT_TRUE(way.takes(inlet(1), 10));
  EXPECT_TRUE(way.takes(inlet(1), 10)) << "two messages may have one time";
  EXPECT_FALSE(way.takes(inlet(2), 20));
  EXPECT_FALSE(way.tidy(start)) << "nothing is to be ended";
}

TEST(Way, GoesOverWithoutAMessageTwiceOrOutOfOrder) {
  Way way(inlet(1));
  ASSERT_TRUE(way.takes(inlet(1), 10));
  way.go_over(inlet(5), start + 1s);
  ASSERT_EQ(way.former(), inlet(1));
  // The new inlet repeats a history, while the former one goes on.
  EXPECT_FALSE(way.takes(inlet(5), 5));
  EXPECT_TRUE(way.takes(inlet(1), 20));
  EXPECT_FALSE(way.takes(inlet(5), 10));
  EXPECT_FALSE(way.takes(inlet(5), 20)) << "it came by the former one";
  EXPECT_FALSE(way.former()) << "the new one has caught up";
  EXPECT_FALSE(way.takes(inlet(1), 30));
  EXPECT_TRUE(way.takes(inlet(5), 30));
}

TEST(Way, GoesOnByTheFormerInletOnlyForAWhile) {
  Way way(inlet(1));
  ASSERT_TRUE(way.takes(inlet(1), 10));
  way.go_over(inlet(5), start + 1s);
  EXPECT_EQ(way.tidy(start), start + 1s);
  EXPECT_EQ(way.tidy(start + 1s), start + 1s + linger);
  EXPECT_FALSE(way.former());
  EXPECT_FALSE(way.takes(inlet(1), 20));
  EXPECT_FALSE(way.takes(inlet(5), 5)) << "still older than what has come";
  EXPECT_FALSE(way.tidy(start + 1s + linger));
  EXPECT_TRUE(way.takes(inlet(5), 5)) << "the writer's clock was set back";
}

TEST(Way, GoesBackToTheInletThatItCameFrom) {
  Way way(inlet(1));
  ASSERT_TRUE(way.takes(inlet(1), 10));
  way.go_over(inlet(5), start + 1s);
  way.go_over(inlet(1), start + 1s);
  EXPECT_FALSE(way.former());
  EXPECT_TRUE(way.takes(inlet(1), 20));
  EXPECT_FALSE(way.takes(inlet(5), 30));
}

TEST(Way, WaitsForWhatFollowsWhenItsInletIsMadeAnew) {
  Way way(inlet(1));
  ASSERT_TRUE(way.takes(inlet(1), 10));
  way.end_inlets({inlet(2)}, start + 1s);
  EXPECT_TRUE(way.takes(inlet(1), 10)) << "another one";
  way.end_inlets({inlet(1)}, start + 1s);
  EXPECT_FALSE(way.takes(inlet(1), 5)) << "the new one repeats the history";
  EXPECT_FALSE(way.takes(inlet(1), 10));
  EXPECT_TRUE(way.takes(inlet(1), 20));
}

TEST(Way, BeginsWithWhatAnotherInletHasRead) {
  Way way(inlet(5));
  way.begin_with(inlet(1), start + 1s);
  EXPECT_TRUE(way.takes(inlet(1), 10));
  EXPECT_FALSE(way.takes(inlet(5), 10));
  EXPECT_TRUE(way.takes(inlet(5), 20));
  EXPECT_FALSE(way.takes(inlet(1), 20));
}

}  // namespace
}  // namespace agnocast::bridge
