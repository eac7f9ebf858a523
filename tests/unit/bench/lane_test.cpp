// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process finds in a lane what another one wrote, no two cells overlap, and a changed
// payload is noticed. Method: a second Lane on the same descriptor, as a role has it.

#include <bench/lane.hpp>

#include <gtest/gtest.h>
#include <unistd.h>

#include <set>
#include <stdexcept>
#include <thread>
#include <vector>

namespace agnocast::bench {
namespace {

const Plan plan{.bytes = 9000, .receivers = 3, .messages = 50, .warm_up = 7};

TEST(Lane, CarriesThePlanToAnAttachedProcess) {
  const Lane made(plan, "some-system", "/some/topic");
  const Lane attached(::dup(made.descriptor()));
  EXPECT_EQ(attached.plan().bytes, plan.bytes);
  EXPECT_EQ(attached.plan().all_messages(), 57u);
  EXPECT_STREQ(attached.head().system, "some-system");
  EXPECT_STREQ(attached.head().topic, "/some/topic");
}

TEST(Lane, KeepsEveryTimeInItsOwnCell) {
  const Lane made(plan, "s", "t");
  const Lane attached(::dup(made.descriptor()));
  std::int64_t value = 0;
  std::set<const void*> cells;
  for (std::uint64_t number = 1; number <= plan.all_messages(); ++number) {
    made.sent(number) = {++value, ++value};
    cells.insert({&made.sent(number).begin_ns, &made.sent(number).end_ns});
    for (std::size_t i = 0; i < plan.receivers; ++i) {
      made.received_ns(i, number) = ++value;
      cells.insert(&made.received_ns(i, number));
    }
  }
  EXPECT_EQ(cells.size(), plan.all_messages() * (2 + plan.receivers));
  value = 0;
  for (std::uint64_t number = 1; number <= plan.all_messages(); ++number) {
    EXPECT_EQ(attached.sent(number).begin_ns, ++value);
    EXPECT_EQ(attached.sent(number).end_ns, ++value);
    for (std::size_t i = 0; i < plan.receivers; ++i)
      EXPECT_EQ(attached.received_ns(i, number), ++value);
  }
  for (std::size_t i = 0; i < Lane::scratch_bytes; ++i)
    ASSERT_EQ(static_cast<const unsigned char*>(attached.scratch())[i], 0);
}

TEST(Lane, RefusesThatOfAnotherBuild) {
  Lane lane(plan, "s", "t");
  ++lane.head().layout;
  EXPECT_THROW(Lane(::dup(lane.descriptor())), std::runtime_error);
}

TEST(Lane, WaitsForTheSlowestReceiver) {
  const Lane lane(plan, "s", "t");
  EXPECT_FALSE(lane.have_all_seen(1));
  lane.seen(0).number = 2;
  lane.seen(2).number = 2;
  EXPECT_FALSE(lane.have_all_seen(1));
  lane.seen(1).number = 1;
  EXPECT_TRUE(lane.have_all_seen(1));
  lane.seen(0).at_ns = 5;
  lane.seen(1).at_ns = 7;
  lane.seen(2).at_ns = 6;
  EXPECT_EQ(lane.all_seen_ns(), 7);
  EXPECT_FALSE(lane.have_all_seen(2));
}

TEST(Lane, WakesAWaiterForItsState) {
  Lane lane(plan, "s", "t");
  std::thread waiting([&lane] { lane.wait_while(Lane::waiting); });
  lane.set_state(Lane::running);
  waiting.join();
  EXPECT_EQ(lane.head().state, Lane::running);
}

TEST(Lane, KeepsTheFirstError) {
  Lane lane(plan, "s", "t");
  EXPECT_EQ(lane.error(), "");
  lane.set_error("first");
  lane.set_error(std::string(1000, 'x'));
  EXPECT_EQ(lane.error(), "first");
}

TEST(Payload, IsCheckedToItsLastByte) {
  std::vector<std::byte> payload(3 * 4096 + 5);
  mark(payload.data(), payload.size(), 42);
  EXPECT_EQ(number_of(payload.data()), 42u);
  EXPECT_TRUE(is_intact(payload.data(), payload.size(), 42));
  EXPECT_FALSE(is_intact(payload.data(), payload.size(), 43));
  for (std::size_t at = 0; at < payload.size(); ++at) {
    payload[at] ^= std::byte{1};
    ASSERT_FALSE(is_intact(payload.data(), payload.size(), 42)) << "byte " << at;
    payload[at] ^= std::byte{1};
  }
}

TEST(Payload, ThatWasNotWrittenAgainIsNoticed) {
  std::vector<std::byte> payload(2 * 4096);
  mark(payload.data(), payload.size(), 1);
  const std::uint64_t next = 2;
  __builtin_memcpy(payload.data(), &next, sizeof next);
  EXPECT_FALSE(is_intact(payload.data(), payload.size(), 2));
}

}  // namespace
}  // namespace agnocast::bench
