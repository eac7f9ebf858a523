// SPDX-License-Identifier: Apache-2.0
//
// Goal: deaths that take many steps share the cycles of the event loop, and a function that waits
// for a death is called once, when all of it is done. Method: registry, endpoint manager and
// regions as in the daemon, with a budget of zero, so that each cycle does one step.

#include <daemon/death/reaping_queue.hpp>
#include <tests/support/processes/daemon_core.hpp>

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace agnocast::daemon {
namespace {

class ReapingQueueTest : public testing::Test {
 protected:
  ClientIndex process_with(int endpoints) {
    const ClientIndex client = core.process(1);
    for (int i = 0; i < endpoints; ++i)
      core.create(client, Kind::publisher,
                  "/" + std::to_string(number(client)) + "/" + std::to_string(i));
    return client;
  }
  void begin(ClientIndex client, std::uint64_t budget_ns = 0) {
    queue.begin(
        client, journal::DeathReason::died,
        [this, client](const Reaped& reaped) {
          ended.push_back(client);
          publishers += reaped.publishers;
        },
        budget_ns);
  }

  test::DaemonCore core;
  ReapingQueue queue{core.registry, core.regions, core.doorbells, core.endpoint_manager};
  std::vector<ClientIndex> ended;
  std::uint64_t publishers = 0;
};

TEST_F(ReapingQueueTest, LogsTheDeathAtOnceAndCallsWhenItIsDone) {
  const ClientIndex client = process_with(3);
  begin(client);
  EXPECT_EQ(core.registry.client(client).state, ClientState::dead);
  EXPECT_TRUE(ended.empty());
  EXPECT_FALSE(queue.is_empty());
  while (!queue.is_empty()) queue.go_on();
  EXPECT_EQ(ended, std::vector{client});
  EXPECT_EQ(publishers, 3u);
  EXPECT_EQ(core.registry.client(client).state, ClientState::free);
}

TEST_F(ReapingQueueTest, KeepsNoDeathThatIsDoneWithinTheBudget) {
  const ClientIndex client = process_with(3);
  begin(client, UINT64_MAX);
  EXPECT_EQ(ended, std::vector{client});
  EXPECT_TRUE(queue.is_empty());
}

TEST_F(ReapingQueueTest, AppendsOnlyToADeathInProgress) {
  const ClientIndex client = process_with(2), other = process_with(1);
  begin(client);
  int called = 0;
  const auto then = [&](const Reaped&) {
    EXPECT_EQ(ended, std::vector{client}) << "after the functions that were there before";
    ++called;
  };
  EXPECT_TRUE(queue.append(client, then));
  EXPECT_FALSE(queue.append(other, then));
  while (!queue.is_empty()) queue.go_on();
  EXPECT_EQ(called, 1);
  EXPECT_FALSE(queue.append(client, then)) << "it is done";
}

TEST_F(ReapingQueueTest, GivesEachDeathItsShare) {
  const ClientIndex much = process_with(300), little = process_with(1);
  begin(much);
  begin(little);
  // A cycle does at least one step, and at most as many as fit into its budget. One cycle for each
  // is enough for the small one.
  for (int turns = 0; ended.empty() && turns < 100; ++turns) queue.go_on();
  ASSERT_FALSE(ended.empty());
  while (!queue.is_empty()) queue.go_on();
  EXPECT_EQ(ended.size(), 2u);
  EXPECT_EQ(publishers, 301u);
}

}  // namespace
}  // namespace agnocast::daemon
