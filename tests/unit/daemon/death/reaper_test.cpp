// SPDX-License-Identifier: Apache-2.0
//
// Goal: the reaper handles the end of a process in short steps whatever it left behind, only in
// topics that it knew, and the daemon may serve others between any two steps. Method: registry,
// endpoint manager and regions as in the daemon, processes without connections; a deadline in the
// past, so that each call is one step; a step's work is counted in redo log records.

#include <daemon/death/reaper.hpp>
#include <tests/support/processes/daemon_core.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

namespace agnocast::daemon {
namespace {

class ReaperTest : public testing::Test {
 protected:
  ClientIndex process(std::uint32_t uid) { return core.process(uid); }
  void create(ClientIndex client, Kind kind, const std::string& topic) {
    core.create(client, kind, topic);
  }
  std::uint64_t lsn() { return registry.log().committed_lsn(); }

  test::DaemonCore core;
  Registry& registry = core.registry;
  Regions& regions = core.regions;
  Doorbells& doorbells = core.doorbells;
  EndpointManager& endpoint_manager = core.endpoint_manager;
};

TEST_F(ReaperTest, EndsAProcessInStepsOfBoundedSize) {
  const ClientIndex a = process(1), b = process(2);
  constexpr int topic_count = 20;
  for (int i = 0; i < topic_count; ++i) {
    const std::string topic = "/topic" + std::to_string(i);
    create(b, Kind::publisher, topic);
    create(a, Kind::subscription, topic);
    create(a, Kind::publisher, topic + "/own");
    create(a, Kind::subscription, topic + "/own");
  }
  Reaping reaping(a, journal::DeathReason::died, registry, regions, doorbells, endpoint_manager);
  std::uint64_t most = 0;
  int steps = 1;
  bool done = false;
  for (; !done; ++steps) {
    const std::uint64_t before = lsn();
    done = reaping.go_on(0);
    most = std::max(most, lsn() - before);
    // Another daemon can continue from the state between two steps.
    Registry next(regions.memory());
    ASSERT_TRUE(next.open());
    ASSERT_LT(steps, 1000);
  }
  EXPECT_LE(most, 3u) << "one record for an endpoint, its topic and its process";
  EXPECT_GT(steps, 3 * topic_count);
  EXPECT_EQ(registry.client(a).state, ClientState::forgotten) << "b still maps its region";
  for (int i = 0; i < topic_count; ++i) {
    const std::string topic = "/topic" + std::to_string(i);
    const auto at = registry.find_topic(0, topic);
    ASSERT_TRUE(at);
    EXPECT_FALSE(registry.notified_of({Kind::publisher, *at, 0}).contains(number(a)));
    EXPECT_FALSE(registry.find_topic(0, topic + "/own")) << "no other process used the topic";
  }
  EXPECT_EQ(registry.endpoints_of(a).size(), std::size_t{topic_count})
      << "the publishers that b was notified of, until it acknowledges";
}

TEST_F(ReaperTest, LooksOnlyInTopicsOfTheProcess) {
  const ClientIndex a = process(1), b = process(2), c = process(3);
  create(a, Kind::publisher, "/here");
  create(b, Kind::subscription, "/here");
  const auto steps_of = [&](ClientIndex client) {
    Reaping reaping(client, journal::DeathReason::died, registry, regions, doorbells,
                    endpoint_manager);
    int steps = 1;
    while (!reaping.go_on(0)) ++steps;
    return steps;
  };
  const int alone = steps_of(a);
  // It belongs to another process, and much more of it is elsewhere.
  const ClientIndex again = process(1);
  for (int i = 0; i < 200; ++i) {
    create(c, Kind::publisher, "/elsewhere" + std::to_string(i));
    create(c, Kind::subscription, "/elsewhere" + std::to_string(i));
  }
  create(again, Kind::publisher, "/there");
  create(b, Kind::subscription, "/there");
  EXPECT_EQ(steps_of(again), alone);
}

// The daemon serves others between two steps: places that they take meanwhile belong to them.
TEST_F(ReaperTest, LeavesAlonePlacesThatOthersTakeMeanwhile) {
  const ClientIndex a = process(1), b = process(2);
  for (const char* const topic : {"/x", "/y", "/z"}) create(a, Kind::publisher, topic);
  Reaping reaping(a, journal::DeathReason::died, registry, regions, doorbells, endpoint_manager);
  int step = 0;
  for (bool done = false; !done; ++step) {
    done = reaping.go_on(0);
    if (step % 2 == 0) create(b, step % 4 == 0 ? Kind::publisher : Kind::subscription, "/x");
    if (step % 3 == 0) create(b, Kind::publisher, "/z");
  }
  EXPECT_EQ(registry.client(a).state, ClientState::free);
  EXPECT_FALSE(registry.find_topic(0, "/y"));
  std::size_t of_b = 0;
  for (const char* const topic : {"/x", "/z"}) {
    const auto at = registry.find_topic(0, topic);
    ASSERT_TRUE(at);
    registry.for_each_publisher(*at, [&](std::uint32_t, const PublisherRecord& record) {
      EXPECT_EQ(record.client, b);
      EXPECT_EQ(record.state, EndpointState::active);
      ++of_b;
    });
    registry.for_each_subscription(*at, [&](std::uint32_t, const SubscriptionRecord& record) {
      EXPECT_EQ(record.client, b);
      ++of_b;
    });
  }
  EXPECT_EQ(of_b, registry.endpoints_of(b).size());
  EXPECT_GT(of_b, 2u);
}

}  // namespace
}  // namespace agnocast::daemon
