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

TEST(ReaderHandover, TakesMessagesOnlyFromItsDdsReader) {
  ReaderHandover handover(dds_reader(1));
  EXPECT_TRUE(handover.takes(dds_reader(1), 10, begin));
  EXPECT_TRUE(handover.takes(dds_reader(1), 10, begin)) << "two messages may have the same time";
  EXPECT_FALSE(handover.takes(dds_reader(2), 20, begin));
  EXPECT_FALSE(handover.next()) << "no DDS reader is to be ended";
}

TEST(ReaderHandover, SwitchesReadersWithoutDuplicatesOrReordering) {
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10, begin));
  handover.go_over(dds_reader(5), begin + 1s);
  ASSERT_EQ(handover.former(), dds_reader(1));
  // The new DDS reader repeats a history, while the former one continues.
  EXPECT_FALSE(handover.takes(dds_reader(5), 5, begin));
  EXPECT_TRUE(handover.takes(dds_reader(1), 20, begin));
  EXPECT_FALSE(handover.takes(dds_reader(5), 10, begin));
  EXPECT_FALSE(handover.takes(dds_reader(5), 20, begin))
      << "the former reader already delivered it";
  EXPECT_FALSE(handover.former()) << "the new reader has caught up";
  EXPECT_FALSE(handover.takes(dds_reader(1), 30, begin));
  EXPECT_TRUE(handover.takes(dds_reader(5), 30, begin));
}

TEST(ReaderHandover, UsesTheFormerDdsReaderOnlyForAWhile) {
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10, begin));
  handover.go_over(dds_reader(5), begin + 1s);
  EXPECT_EQ(handover.next(), begin + 1s);
  EXPECT_FALSE(handover.is_former_due(begin));
  ASSERT_TRUE(handover.is_former_due(begin + 1s));
  EXPECT_TRUE(handover.takes(dds_reader(1), 20, begin + 1s)) << "one of its last messages";
  handover.end_former();
  EXPECT_FALSE(handover.next());
  EXPECT_FALSE(handover.takes(dds_reader(1), 30, begin + 1s));
  EXPECT_TRUE(handover.takes(dds_reader(5), 30, begin + 1s));
}

TEST(ReaderHandover, RejectsWhatCameAlreadyHoweverLateTheNewDdsReaderGivesIt) {
  constexpr Time late = begin + 24h;
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10, begin));
  handover.go_over(dds_reader(5), begin + 1s);
  handover.end_former();
  EXPECT_FALSE(handover.takes(dds_reader(5), 5, late));
  EXPECT_FALSE(handover.takes(dds_reader(5), 10, late));
  EXPECT_TRUE(handover.takes(dds_reader(5), 20, late));
  EXPECT_TRUE(handover.takes(dds_reader(5), 15, late)) << "its clock was set back afterwards";
}

TEST(ReaderHandover, RejectsOlderMessagesOnlyForAWhile) {
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10, begin));
  handover.go_over(dds_reader(5), begin + 1s);
  EXPECT_FALSE(handover.takes(dds_reader(5), 5, begin + 1s));
  EXPECT_FALSE(handover.takes(dds_reader(5), 6, begin + 1s + rejecting_max - 1ns));
  EXPECT_TRUE(handover.takes(dds_reader(5), 7, begin + 1s + rejecting_max))
      << "the writer's clock was set back";
  EXPECT_TRUE(handover.takes(dds_reader(5), 8, begin + 1s + rejecting_max));
}

TEST(ReaderHandover, CanSwitchBackToTheFormerDdsReader) {
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10, begin));
  handover.go_over(dds_reader(5), begin + 1s);
  handover.go_over(dds_reader(1), begin + 1s);
  EXPECT_FALSE(handover.former());
  EXPECT_TRUE(handover.takes(dds_reader(1), 20, begin));
  EXPECT_FALSE(handover.takes(dds_reader(5), 30, begin));
}

TEST(ReaderHandover, SkipsRepeatedHistoryWhenItsDdsReaderIsRecreated) {
  ReaderHandover handover(dds_reader(1));
  ASSERT_TRUE(handover.takes(dds_reader(1), 10, begin));
  handover.end_dds_readers({dds_reader(2)});
  EXPECT_TRUE(handover.takes(dds_reader(1), 10, begin)) << "another reader ended";
  handover.end_dds_readers({dds_reader(1)});
  EXPECT_FALSE(handover.takes(dds_reader(1), 5, begin)) << "the new reader repeats the history";
  EXPECT_FALSE(handover.takes(dds_reader(1), 10, begin));
  EXPECT_TRUE(handover.takes(dds_reader(1), 20, begin));
}

TEST(ReaderHandover, CanBeginWithMessagesOfAnotherDdsReader) {
  ReaderHandover handover(dds_reader(5));
  handover.begin_with(dds_reader(1), begin + 1s);
  EXPECT_TRUE(handover.takes(dds_reader(1), 10, begin));
  EXPECT_FALSE(handover.takes(dds_reader(5), 10, begin));
  EXPECT_TRUE(handover.takes(dds_reader(5), 20, begin));
  EXPECT_FALSE(handover.takes(dds_reader(1), 20, begin));
}

}  // namespace
}  // namespace agnocast::bridge
