// SPDX-License-Identifier: Apache-2.0
//
// Goal: a thread gets the first rule that matches a group of its executors; a change of groups
// makes exactly the threads due whose rule changes.
// Method: the table alone.

#include <daemon/state/callback_threads.hpp>

#include <gmock/gmock.h>

#include <cstdint>
#include <optional>
#include <vector>

namespace agnocast::daemon {
namespace {

using abi::wire::ThreadSetting;
using testing::ElementsAre;
using testing::IsEmpty;

constexpr std::uint64_t executor = 1, other_executor = 2;

class CallbackThreadsTable : public testing::Test {
 protected:
  static constexpr CallbackThreads::Rule none = std::nullopt;

  void add_group(std::uint64_t of, std::uint64_t group, CallbackThreads::Rule rule) {
    threads.add_group({of, group}, "/node", "", false, rule);
  }
  /// Takes all due threads and returns their numbers.
  std::vector<std::uint32_t> due() {
    std::vector<std::uint32_t> numbers;
    while (const auto next = threads.next_due()) {
      numbers.push_back(next->thread);
      threads.note_outcome(*next, {ThreadSetting::applied});
    }
    return numbers;
  }
  const CallbackThreads::Thread& thread(std::uint32_t number) const {
    return threads.threads().at(number);
  }

  CallbackThreads threads;
};

TEST_F(CallbackThreadsTable, AThreadGetsTheRuleOfItsGroup) {
  add_group(executor, 10, 1);
  EXPECT_THAT(due(), IsEmpty());
  threads.add_thread(executor, 100);
  EXPECT_EQ(thread(100).outcome.setting, ThreadSetting::due);
  EXPECT_THAT(due(), ElementsAre(100));
  EXPECT_EQ(thread(100).rule, 1u);
  EXPECT_EQ(thread(100).outcome.setting, ThreadSetting::applied);
  EXPECT_FALSE(threads.has_due());
}

TEST_F(CallbackThreadsTable, AThreadWithoutAMatchingGroupGetsNone) {
  add_group(executor, 10, none);
  threads.add_thread(executor, 100);
  EXPECT_FALSE(threads.has_due());
  EXPECT_EQ(thread(100).outcome.setting, ThreadSetting::no_rule);
}

TEST_F(CallbackThreadsTable, OfSeveralGroupsTheEarliestRuleApplies) {
  add_group(executor, 10, 2);
  threads.add_thread(executor, 100);
  EXPECT_THAT(due(), ElementsAre(100));
  add_group(executor, 11, 0);
  EXPECT_THAT(due(), ElementsAre(100));
  EXPECT_EQ(thread(100).rule, 0u);
  add_group(executor, 12, 1);
  EXPECT_FALSE(threads.has_due()) << "a later rule changes nothing";
}

TEST_F(CallbackThreadsTable, WhenTheGroupLeavesTheNextRuleApplies) {
  add_group(executor, 10, 0);
  add_group(executor, 11, 0);
  add_group(executor, 12, 2);
  threads.add_thread(executor, 100);
  EXPECT_THAT(due(), ElementsAre(100));
  EXPECT_TRUE(threads.remove_group({executor, 10}));
  EXPECT_FALSE(threads.has_due()) << "another group has the same rule";
  EXPECT_TRUE(threads.remove_group({executor, 11}));
  EXPECT_THAT(due(), ElementsAre(100));
  EXPECT_EQ(thread(100).rule, 2u);
  EXPECT_TRUE(threads.remove_group({executor, 12}));
  EXPECT_THAT(due(), IsEmpty());
  EXPECT_EQ(thread(100).outcome.setting, ThreadSetting::no_rule);
  EXPECT_FALSE(threads.remove_group({executor, 12}));
}

TEST_F(CallbackThreadsTable, GroupsConcernTheThreadsOfTheirExecutorOnly) {
  threads.add_thread(executor, 100);
  threads.add_thread(executor, 101);
  threads.add_thread(other_executor, 200);
  add_group(other_executor, 10, 0);
  EXPECT_THAT(due(), ElementsAre(200));
  add_group(executor, 11, 1);
  EXPECT_THAT(due(), ElementsAre(100, 101));
}

TEST_F(CallbackThreadsTable, AThreadOfTwoExecutorsGetsTheEarliestRuleOfBoth) {
  add_group(executor, 10, 2);
  add_group(other_executor, 11, 1);
  threads.add_thread(executor, 100);
  threads.add_thread(other_executor, 100);
  EXPECT_EQ(threads.spin_count(), 2u);
  EXPECT_THAT(due(), ElementsAre(100)) << "once, although it became due twice";
  EXPECT_EQ(thread(100).rule, 1u);
  EXPECT_TRUE(threads.remove_thread(other_executor, 100));
  EXPECT_THAT(due(), ElementsAre(100));
  EXPECT_EQ(thread(100).rule, 2u);
}

TEST_F(CallbackThreadsTable, AThreadThatHasEndedIsNotDue) {
  add_group(executor, 10, 0);
  threads.add_thread(executor, 100);
  EXPECT_TRUE(threads.remove_thread(executor, 100));
  EXPECT_FALSE(threads.remove_thread(executor, 100));
  EXPECT_THAT(due(), IsEmpty());
  EXPECT_EQ(threads.spin_count(), 0u);
  threads.add_thread(executor, 100);  // another thread with its number
  EXPECT_THAT(due(), ElementsAre(100));
}

TEST_F(CallbackThreadsTable, AThreadThatEndsAndBeginsAgainAndAgainIsDueOnce) {
  add_group(executor, 10, 0);
  for (int i = 0; i < 100; ++i) {
    threads.add_thread(executor, 100);
    EXPECT_TRUE(threads.remove_thread(executor, 100));
  }
  threads.add_thread(executor, 100);
  EXPECT_THAT(due(), ElementsAre(100));
}

TEST_F(CallbackThreadsTable, AnOutcomeOfAnEarlierTurnIsForgotten) {
  add_group(executor, 10, 1);
  threads.add_thread(executor, 100);
  const auto first = threads.next_due();
  ASSERT_TRUE(first);
  add_group(executor, 11, 0);
  threads.note_outcome(*first, {ThreadSetting::refused});
  EXPECT_EQ(thread(100).outcome.setting, ThreadSetting::due);
  const auto second = threads.next_due();
  ASSERT_TRUE(second);
  EXPECT_EQ(second->rule, 0u);
  threads.note_outcome(*second, {ThreadSetting::applied});
  EXPECT_EQ(thread(100).outcome.setting, ThreadSetting::applied);
}

TEST_F(CallbackThreadsTable, RepeatedStatementsChangeNothing) {
  add_group(executor, 10, 0);
  add_group(executor, 10, 1);
  threads.add_thread(executor, 100);
  threads.add_thread(executor, 100);
  EXPECT_EQ(threads.groups().size(), 1u);
  EXPECT_EQ(threads.spin_count(), 1u);
  EXPECT_THAT(due(), ElementsAre(100));
  EXPECT_TRUE(threads.remove_group({executor, 10}));
  EXPECT_EQ(thread(100).outcome.setting, ThreadSetting::no_rule);
}

TEST_F(CallbackThreadsTable, WhatWasLeftOutIsCounted) {
  threads.leave_out();
  threads.leave_out();
  threads.leave_out_no_more();
  EXPECT_EQ(threads.left_out(), 1u);
  threads.leave_out_no_more();
  threads.leave_out_no_more();
  EXPECT_EQ(threads.left_out(), 0u);
}

}  // namespace
}  // namespace agnocast::daemon
