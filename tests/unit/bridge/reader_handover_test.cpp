// SPDX-License-Identifier: Apache-2.0

#include <bridge/inward/reader_handover.hpp>

#include <gtest/gtest.h>

namespace agnocast::bridge {
namespace {

using namespace std::chrono_literals;

constexpr Time begin{100s};

ReaderKey dds_reader(std::size_t depth) {
  return {{{"/chatter", "std_msgs/msg/String"}, {}}, depth, false};
}

using Left = ReaderHandover::Left;

Left useful(const ReaderKey&) { return Left::useful; }
Left lossy(const ReaderKey&) { return Left::lossy; }
Left ended(const ReaderKey&) { return Left::ended; }

TEST(ReaderHandover, TakesMessagesOnlyFromItsDdsReader) {
  ReaderHandover handover(dds_reader(1));
  EXPECT_TRUE(handover.takes(dds_reader(1), 10));
  EXPECT_TRUE(handover.takes(dds_reader(1), 10)) << "two messages may have the same time";
  EXPECT_FALSE(handover.takes(dds_reader(2), 20));
  EXPECT_FALSE(handover.next()) << "no DDS reader is to be ended";
}

TEST(ReaderHandover, SwitchesReadersWithoutDuplicatesOrReordering) {
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10));
  handover.go_over(dds_reader(5), useful, false, begin);
  ASSERT_EQ(handover.former(), dds_reader(1));
  // The new DDS reader repeats a history, while the former one continues.
  EXPECT_FALSE(handover.takes(dds_reader(5), 5));
  EXPECT_TRUE(handover.takes(dds_reader(1), 20));
  EXPECT_FALSE(handover.takes(dds_reader(5), 10));
  EXPECT_FALSE(handover.takes(dds_reader(5), 20)) << "the former reader already delivered it";
  EXPECT_FALSE(handover.former()) << "the new reader has caught up";
  EXPECT_FALSE(handover.takes(dds_reader(1), 30));
  EXPECT_TRUE(handover.takes(dds_reader(5), 30));
}

TEST(ReaderHandover, UsesTheFormerDdsReaderOnlyForAWhile) {
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10));
  handover.go_over(dds_reader(5), useful, false, begin);
  EXPECT_EQ(handover.next(), begin + linger);
  EXPECT_FALSE(handover.is_former_due(begin + linger - 1ns));
  ASSERT_TRUE(handover.is_former_due(begin + linger));
  EXPECT_TRUE(handover.takes(dds_reader(1), 20)) << "one of its last messages";
  handover.end_due(begin + linger);
  EXPECT_FALSE(handover.takes(dds_reader(1), 30));
  EXPECT_FALSE(handover.takes(dds_reader(5), 15)) << "still older than the last message taken";
  EXPECT_TRUE(handover.takes(dds_reader(5), 30));
  EXPECT_FALSE(handover.next());
}

TEST(ReaderHandover, RejectsOlderMessagesOnlyForAWhile) {
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10));
  handover.go_over(dds_reader(5), useful, false, begin);
  handover.end_due(begin + linger);
  EXPECT_EQ(handover.next(), begin + rejecting_max);
  EXPECT_FALSE(handover.is_rejecting_due(begin + rejecting_max - 1ns));
  ASSERT_TRUE(handover.is_rejecting_due(begin + rejecting_max));
  EXPECT_FALSE(handover.takes(dds_reader(5), 5)) << "it was there before";
  handover.end_due(begin + rejecting_max);
  EXPECT_TRUE(handover.takes(dds_reader(5), 5)) << "the writer's clock was set back";
  EXPECT_FALSE(handover.next());
}

TEST(ReaderHandover, TakesWhatAQuietReaderHasWhenItGoesOverAgain) {
  for (const Time later : {begin + linger, begin + rejecting_max}) {
    ReaderHandover handover(dds_reader(1));
    ASSERT_TRUE(handover.takes(dds_reader(1), 10));
    handover.go_over(dds_reader(5), useful, false, begin);
    handover.end_due(later);
    handover.go_over(dds_reader(9), useful, false, later);
    ASSERT_EQ(handover.former(), dds_reader(5));
    EXPECT_EQ(handover.takes(dds_reader(5), 5), later == begin + rejecting_max) << "a history";
    EXPECT_TRUE(handover.takes(dds_reader(5), 20));
    EXPECT_FALSE(handover.takes(dds_reader(9), 20));
    EXPECT_TRUE(handover.takes(dds_reader(9), 30));
  }
}

TEST(ReaderHandover, KeepsTheFormerReaderUntilALaterOneHasBegun) {
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10));
  handover.go_over(dds_reader(5), useful, false, begin);
  handover.go_over(dds_reader(9), useful, false, begin);
  ASSERT_EQ(handover.former(), dds_reader(1));
  EXPECT_FALSE(handover.takes(dds_reader(5), 20));
  EXPECT_TRUE(handover.takes(dds_reader(1), 20));
  EXPECT_TRUE(handover.takes(dds_reader(9), 30));
}

TEST(ReaderHandover, TakesNothingMoreFromALossyReader) {
  for (const bool repeats : {false, true}) {
    ReaderHandover handover(dds_reader(1));
    ASSERT_TRUE(handover.takes(dds_reader(1), 10));
    handover.go_over(dds_reader(5), lossy, repeats, begin);
    EXPECT_FALSE(handover.takes(dds_reader(1), 30)) << "it may lack 20";
    EXPECT_FALSE(handover.takes(dds_reader(5), 10));
    EXPECT_TRUE(handover.takes(dds_reader(5), 20));
    EXPECT_TRUE(handover.takes(dds_reader(5), 30));
  }
}

// From 1, which loses messages as soon as 5 exists, over 5 to 9.
TEST(ReaderHandover, TakesFromARepeatingReaderWhatEarlierOnesMayLack) {
  for (const bool repeats : {false, true}) {
    ReaderHandover handover(dds_reader(1));
    ASSERT_TRUE(handover.takes(dds_reader(1), 10));
    handover.go_over(dds_reader(5), lossy, false, begin);
    handover.go_over(dds_reader(9), useful, repeats, begin);
    EXPECT_EQ(handover.takes(dds_reader(5), 30), !repeats) << "it may have begun behind 20";
    EXPECT_EQ(handover.takes(dds_reader(9), 20), repeats);
    EXPECT_EQ(handover.takes(dds_reader(9), 30), repeats);
    EXPECT_TRUE(handover.takes(dds_reader(9), 40));
  }
}

TEST(ReaderHandover, LeavesAFormerReaderThatLosesMessages) {
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10));
  handover.go_over(dds_reader(5), useful, false, begin);
  handover.go_over(dds_reader(9), lossy, true, begin);
  EXPECT_FALSE(handover.former());
  EXPECT_FALSE(handover.takes(dds_reader(1), 30)) << "it may lack 20";
  EXPECT_TRUE(handover.takes(dds_reader(9), 20));
}

TEST(ReaderHandover, KeepsAReaderThatHasBegunForARepeatingOne) {
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10));
  handover.go_over(dds_reader(5), lossy, false, begin);
  ASSERT_TRUE(handover.takes(dds_reader(5), 20));
  handover.go_over(dds_reader(9), useful, true, begin);
  EXPECT_TRUE(handover.takes(dds_reader(5), 30));
  EXPECT_FALSE(handover.takes(dds_reader(9), 20));
  EXPECT_TRUE(handover.takes(dds_reader(9), 40));
}

TEST(ReaderHandover, NeverReturnsToAnEndedReader) {
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10));
  handover.end_dds_readers({dds_reader(1)}, begin);
  handover.go_over(dds_reader(5), ended, false, begin);
  EXPECT_FALSE(handover.former());
  handover.go_over(dds_reader(9), useful, false, begin);
  EXPECT_EQ(handover.former(), dds_reader(5));
  EXPECT_FALSE(handover.takes(dds_reader(5), 5)) << "a history";
  EXPECT_TRUE(handover.takes(dds_reader(5), 20));
  EXPECT_TRUE(handover.takes(dds_reader(9), 30));
}

TEST(ReaderHandover, CanSwitchBackToTheFormerDdsReader) {
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10));
  handover.go_over(dds_reader(5), useful, false, begin);
  handover.go_over(dds_reader(1), useful, false, begin);
  EXPECT_FALSE(handover.former());
  EXPECT_TRUE(handover.takes(dds_reader(1), 20));
  EXPECT_FALSE(handover.takes(dds_reader(5), 30));
}

TEST(ReaderHandover, SkipsRepeatedHistoryWhenItsDdsReaderIsRecreated) {
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10));
  handover.end_dds_readers({dds_reader(2)}, begin);
  EXPECT_TRUE(handover.takes(dds_reader(1), 10)) << "another reader ended";
  handover.end_dds_readers({dds_reader(1)}, begin);
  EXPECT_FALSE(handover.takes(dds_reader(1), 5)) << "the new reader repeats the history";
  EXPECT_FALSE(handover.takes(dds_reader(1), 10));
  EXPECT_TRUE(handover.takes(dds_reader(1), 20));
}

TEST(ReaderHandover, CanBeginWithMessagesOfAnotherDdsReader) {
  ReaderHandover handover(dds_reader(5));
  handover.begin_with(dds_reader(1), begin);
  EXPECT_TRUE(handover.takes(dds_reader(1), 10));
  EXPECT_FALSE(handover.takes(dds_reader(5), 10));
  EXPECT_TRUE(handover.takes(dds_reader(5), 20));
  EXPECT_FALSE(handover.takes(dds_reader(1), 20));
}

}  // namespace
}  // namespace agnocast::bridge
