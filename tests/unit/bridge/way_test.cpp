// SPDX-License-Identifier: Apache-2.0

#include <bridge/inward/way.hpp>

#include <gtest/gtest.h>

namespace agnocast::bridge {
namespace {

using namespace std::chrono_literals;

constexpr Time start{100s};

ReaderKey dds_reader(std::size_t depth) {
  return {{{"/chatter", "std_msgs/msg/String"}, {}}, depth, false};
}

TEST(Way, TakesMessagesOnlyFromItsDdsReader) {
  Way way(dds_reader(1));
  EXPECT_TRUE(way.takes(dds_reader(1), 10));
  EXPECT_TRUE(way.takes(dds_reader(1), 10)) << "two messages may have the same time";
  EXPECT_FALSE(way.takes(dds_reader(2), 20));
  EXPECT_FALSE(way.tidy(start)) << "no DDS reader is to be ended";
}

TEST(Way, SwitchesReadersWithoutDuplicatesOrReordering) {
  Way way(dds_reader(1));
  ASSERT_TRUE(way.takes(dds_reader(1), 10));
  way.go_over(dds_reader(5), start + 1s);
  ASSERT_EQ(way.former(), dds_reader(1));
  // The new DDS reader repeats a history, while the former one continues.
  EXPECT_FALSE(way.takes(dds_reader(5), 5));
  EXPECT_TRUE(way.takes(dds_reader(1), 20));
  EXPECT_FALSE(way.takes(dds_reader(5), 10));
  EXPECT_FALSE(way.takes(dds_reader(5), 20)) << "the former reader already delivered it";
  EXPECT_FALSE(way.former()) << "the new reader has caught up";
  EXPECT_FALSE(way.takes(dds_reader(1), 30));
  EXPECT_TRUE(way.takes(dds_reader(5), 30));
}

TEST(Way, UsesTheFormerDdsReaderOnlyForAWhile) {
  Way way(dds_reader(1));
  ASSERT_TRUE(way.takes(dds_reader(1), 10));
  way.go_over(dds_reader(5), start + 1s);
  EXPECT_EQ(way.tidy(start), start + 1s);
  EXPECT_EQ(way.tidy(start + 1s), start + 1s + linger);
  EXPECT_FALSE(way.former());
  EXPECT_FALSE(way.takes(dds_reader(1), 20));
  EXPECT_FALSE(way.takes(dds_reader(5), 5)) << "still older than the last message taken";
  EXPECT_FALSE(way.tidy(start + 1s + linger));
  EXPECT_TRUE(way.takes(dds_reader(5), 5)) << "the writer's clock was set back";
}

TEST(Way, CanSwitchBackToTheFormerDdsReader) {
  Way way(dds_reader(1));
  ASSERT_TRUE(way.takes(dds_reader(1), 10));
  way.go_over(dds_reader(5), start + 1s);
  way.go_over(dds_reader(1), start + 1s);
  EXPECT_FALSE(way.former());
  EXPECT_TRUE(way.takes(dds_reader(1), 20));
  EXPECT_FALSE(way.takes(dds_reader(5), 30));
}

TEST(Way, SkipsRepeatedHistoryWhenItsDdsReaderIsRecreated) {
  Way way(dds_reader(1));
  ASSERT_TRUE(way.takes(dds_reader(1), 10));
  way.end_dds_readers({dds_reader(2)}, start + 1s);
  EXPECT_TRUE(way.takes(dds_reader(1), 10)) << "another reader ended";
  way.end_dds_readers({dds_reader(1)}, start + 1s);
  EXPECT_FALSE(way.takes(dds_reader(1), 5)) << "the new reader repeats the history";
  EXPECT_FALSE(way.takes(dds_reader(1), 10));
  EXPECT_TRUE(way.takes(dds_reader(1), 20));
}

TEST(Way, CanBeginWithMessagesOfAnotherDdsReader) {
  Way way(dds_reader(5));
  way.begin_with(dds_reader(1), start + 1s);
  EXPECT_TRUE(way.takes(dds_reader(1), 10));
  EXPECT_FALSE(way.takes(dds_reader(5), 10));
  EXPECT_TRUE(way.takes(dds_reader(5), 20));
  EXPECT_FALSE(way.takes(dds_reader(1), 20));
}

}  // namespace
}  // namespace agnocast::bridge
