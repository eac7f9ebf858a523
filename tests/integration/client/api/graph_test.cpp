// SPDX-License-Identifier: Apache-2.0
//
// Goal: agnocast::Graph reports how every endpoint was created, reports again when something has
// changed and only then, in any process and incarnation of the daemon, and disturbs nobody. Method:
// the real daemon; endpoints of raw clients (CtlNode), so that the test determines every fact.

#include <agnocast/graph.hpp>
#include <tests/integration/ctl/ctl_node.hpp>
#include <tests/support/node_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>
#include <tests/support/wire/wire_dump.hpp>

#include <gmock/gmock.h>

#include <atomic>
#include <chrono>
#include <map>
#include <optional>
#include <string>
#include <thread>
#include <vector>

namespace agnocast {
namespace {

using namespace std::chrono_literals;
using test::CtlNode;
using test::NodeProcess;
using testing::SizeIs;

// Only a failing test waits this long.
constexpr auto patience = 5min;

class GraphTest : public test::SuiteDaemon {
 protected:
  // Endpoints of the test before may still be leaving.
  void SetUp() override { until_there_are(0); }

  GraphSnapshot changed() {
    auto snapshot = graph_.wait(patience);
    EXPECT_TRUE(snapshot) << snapshot.error().what;
    if (!snapshot) return {};
    EXPECT_TRUE(*snapshot) << "the graph reported no change";
    return snapshot->value_or(GraphSnapshot{});
  }
  /// Returns the snapshot that fits. A change may come in two parts.
  template <class Condition>
  GraphSnapshot changed_until(Condition condition) {
    const auto deadline = std::chrono::steady_clock::now() + patience;
    for (;;) {
      GraphSnapshot snapshot = changed();
      if (condition(snapshot) || HasFailure()) return snapshot;
      if (std::chrono::steady_clock::now() > deadline) {
        ADD_FAILURE() << "the graph never reported it";
        return snapshot;
      }
    }
  }
  GraphSnapshot until_there_are(std::size_t count) {
    return changed_until([&](const GraphSnapshot& now) { return now.endpoints.size() == count; });
  }
  void nothing_changes() {
    const auto snapshot = graph_.wait(100ms);
    ASSERT_TRUE(snapshot) << snapshot.error().what;
    EXPECT_FALSE(*snapshot) << snapshot->value().endpoints.size() << " endpoints";
  }

  Graph graph_;
};

TEST_F(GraphTest, ReportsHowEveryEndpointWasCreated) {
  CtlNode talker(daemon->socket_path(), 0, "talker_process"),
      listener(daemon->socket_path(), 7, "listener_process");
  abi::Qos kept{9};
  kept.transient_local = true;
  kept.manual_liveliness = true;
  kept.deadline_ns = 1;
  kept.lifespan_ns = 2;
  kept.lease_ns = 3;
  const auto publisher = talker.publisher("/points", kept, "/ns/deep/talker", "test/msg/Cloud");
  abi::Qos all{1000};
  all.keep_all = true;
  all.reliable = false;
  const auto subscription = listener.subscription("/points", all, "/listener", "test/msg/Cloud");

  const GraphSnapshot now = until_there_are(2);
  ASSERT_THAT(now.endpoints, SizeIs(2));
  const EndpointInfo& first = now.endpoints[0];
  EXPECT_EQ(first.kind, EndpointKind::publisher);
  EXPECT_EQ(first.domain, 0u);
  EXPECT_EQ(first.topic, "/points");
  EXPECT_EQ(first.type, "test/msg/Cloud");
  EXPECT_EQ(first.node_name, "talker");
  EXPECT_EQ(first.node_namespace, "/ns/deep");
  EXPECT_EQ(first.qos.depth(), 9u);
  EXPECT_TRUE(first.qos.is_reliable());
  EXPECT_TRUE(first.qos.is_transient_local());
  EXPECT_FALSE(first.qos.is_keep_all());
  EXPECT_EQ(first.qos.deadline(), 1ns);
  EXPECT_EQ(first.qos.lifespan(), 2ns);
  EXPECT_EQ(first.qos.liveliness_lease_duration(), 3ns);
  EXPECT_EQ(first.qos.liveliness(), Liveliness::manual_by_topic);
  EXPECT_EQ(first.generation, publisher.generation);
  EXPECT_EQ(first.pid, static_cast<std::uint32_t>(::getpid()));
  EXPECT_EQ(first.uid, ::geteuid());
  EXPECT_EQ(first.process_name, "talker_process");
  EXPECT_FALSE(first.is_own) << "of a client that is not the library's, though in this process";
  const EndpointInfo& second = now.endpoints[1];
  EXPECT_EQ(second.kind, EndpointKind::subscription);
  EXPECT_EQ(second.domain, 7u);
  EXPECT_EQ(second.node_name, "listener");
  EXPECT_EQ(second.node_namespace, "/");
  EXPECT_TRUE(second.qos.is_keep_all());
  EXPECT_FALSE(second.qos.is_reliable());
  EXPECT_FALSE(second.qos.is_transient_local());
  EXPECT_EQ(second.qos.deadline(), 0ns);
  EXPECT_EQ(second.qos.liveliness(), Liveliness::automatic);
  EXPECT_EQ(second.generation, subscription.generation);
  EXPECT_NE(second.client, first.client);
  EXPECT_EQ(now.incarnation, test::wire_dump(daemon->socket_path()).incarnation);
  EXPECT_EQ(now.missing, 0u);
}

TEST_F(GraphTest, ReportsAgainWhenAnEndpointComesLeavesOrDies) {
  nothing_changes();
  CtlNode node(daemon->socket_path());
  const auto publisher = node.publisher("/points");
  EXPECT_EQ(until_there_are(1).endpoints[0].generation, publisher.generation);
  node.subscription("/points");
  until_there_are(2);
  nothing_changes();

  NodeProcess other(daemon->socket_path(), [](CtlNode& process) { process.publisher("/others"); });
  const GraphSnapshot three = until_there_are(3);
  EXPECT_EQ(three.endpoints[0].topic, "/others");
  EXPECT_EQ(three.endpoints[0].pid, static_cast<std::uint32_t>(other.pid()));
  EXPECT_NE(three.endpoints[0].client, three.endpoints[1].client);
  other.kill();
  other.wait();
  until_there_are(2);
  node.wire.reference(abi::wire::Opcode::leave, abi::wire::Kind::publisher, publisher.topic,
                      publisher.index, publisher.generation);
  EXPECT_EQ(until_there_are(1).endpoints[0].kind, EndpointKind::subscription);
}

// The changes of one watch, put together, are what another watch sees.
TEST_F(GraphTest, ReportsChangesOnly) {
  Graph watch;
  std::map<std::uint64_t, std::string> known;  // topic by generation
  std::size_t added = 0, states = 0;
  const auto follow_until = [&](std::size_t count) {
    do {
      const auto changed = watch.wait_for_change(patience);
      ASSERT_TRUE(changed && *changed);
      const auto next = watch.look();
      if (!next) continue;  // the last look has seen it
      if (next->is_reset) known.clear();
      states += next->is_reset;
      for (const std::uint64_t generation : next->removed) EXPECT_EQ(known.erase(generation), 1u);
      for (const EndpointInfo& endpoint : next->added)
        EXPECT_TRUE(known.emplace(endpoint.generation, endpoint.topic).second);
      added += next->added.size();
    } while (known.size() != count);
    const auto whole = Graph().wait(patience);
    ASSERT_TRUE(whole && *whole);
    EXPECT_EQ((*whole)->endpoints.size(), count);
    for (const EndpointInfo& endpoint : (*whole)->endpoints)
      EXPECT_EQ(known[endpoint.generation], endpoint.topic);
  };
  CtlNode stays(daemon->socket_path());
  stays.publisher("/stays");
  follow_until(1);
  for (std::size_t round = 1; round <= 10; ++round) {
    std::optional<CtlNode> node(daemon->socket_path());
    for (std::size_t i = 0; i < round; ++i) node->publisher("/comes" + std::to_string(i));
    follow_until(1 + round);
    node.reset();
    follow_until(1);
  }
  EXPECT_EQ(states, 1u);
  EXPECT_EQ(added, 1u + 55u) << "each once";
  EXPECT_FALSE(watch.wait_for_change(50ms).value());
  EXPECT_FALSE(watch.look());
  watch.start_over();
  const auto again = watch.look();
  ASSERT_TRUE(again);
  EXPECT_TRUE(again->is_reset);
  EXPECT_THAT(again->added, SizeIs(1));
  daemon->kill_worker();
  follow_until(1);  // of the next daemon, the same tables
  EXPECT_GE(states, 2u);
}

TEST_F(GraphTest, WakesForAChangeWhileItWaits) {
  std::optional<CtlNode> node;
  std::thread comes([&] {
    node.emplace(daemon->socket_path());
    node->publisher("/points");
  });
  until_there_are(1);
  comes.join();
}

TEST_F(GraphTest, EndsItsWaitWhenInterruptedAndLosesNothing) {
  std::thread interrupts([&] { graph_.interrupt(); });
  const auto ended = graph_.wait(patience);
  interrupts.join();
  ASSERT_TRUE(ended) << ended.error().what;
  EXPECT_FALSE(*ended);
  graph_.interrupt();  // before the next wait
  EXPECT_FALSE(graph_.wait(patience).value());
  CtlNode node(daemon->socket_path());
  node.publisher("/points");
  until_there_are(1);
}

TEST_F(GraphTest, ServesAnyNumberOfWatches) {
  std::vector<Graph> others(20);
  for (Graph& other : others) EXPECT_TRUE(other.wait(patience).value().has_value());
  CtlNode node(daemon->socket_path());
  node.publisher("/points");
  for (Graph& other : others) {
    const auto now = other.wait(patience);
    ASSERT_TRUE(now && *now);
    EXPECT_EQ((*now)->endpoints.size(), 1u);
  }
  EXPECT_EQ(Graph().wait(0ms).value().value().endpoints.size(), 1u) << "the first time at once";
}

TEST_F(GraphTest, GoesOnAfterARestartOfTheDaemon) {
  CtlNode node(daemon->socket_path());
  const auto publisher = node.publisher("/points");
  const std::uint64_t incarnation = until_there_are(1).incarnation;
  daemon->kill_worker();
  // Its supervisor starts the next daemon, which has the same tables.
  const GraphSnapshot again =
      changed_until([](const GraphSnapshot& now) { return now.endpoints.size() == 1; });
  EXPECT_EQ(again.incarnation, incarnation);
  EXPECT_EQ(again.endpoints[0].generation, publisher.generation);
  CtlNode next(daemon->socket_path());
  next.publisher("/others");
  until_there_are(2);
}

TEST_F(GraphTest, WatchesWhileDaemonsDie) {
  std::atomic<bool> ends{false};
  std::vector<std::thread> watchers;
  for (int i = 0; i < 4; ++i)
    watchers.emplace_back([&] {
      while (!ends) {
        Graph watch;
        for (int looks = 0; looks < 20 && !ends; ++looks) (void)watch.wait(1ms);
      }
    });
  for (int i = 0; i < 5; ++i) {
    const pid_t killed = daemon->kill_worker();
    ASSERT_TRUE(daemon->wait_for_next(killed));
    std::this_thread::sleep_for(50ms);
  }
  ends = true;
  for (std::thread& watcher : watchers) watcher.join();
  CtlNode node(daemon->socket_path());
  node.publisher("/points");
  until_there_are(1);
}

TEST_F(GraphTest, ANewWatchAfterARestartSeesThePresent) {
  std::optional<CtlNode> node(daemon->socket_path());
  node->publisher("/points");
  until_there_are(1);
  node.reset();
  daemon->kill_worker();
  // Nobody waited, so nobody was notified.
  const auto deadline = std::chrono::steady_clock::now() + patience;
  while (Graph().wait(patience).value().value().endpoints.size() != 0)
    ASSERT_LT(std::chrono::steady_clock::now(), deadline);
}

TEST_F(GraphTest, IsNoEndpointAndChangesNothing) {
  CtlNode node(daemon->socket_path());
  node.publisher("/points");
  const auto before = test::wire_dump(daemon->socket_path());
  until_there_are(1);
  nothing_changes();
  const auto after = test::wire_dump(daemon->socket_path());
  EXPECT_EQ(after.processes.size(), before.processes.size());
  EXPECT_EQ(after.endpoints.size(), before.endpoints.size());
  EXPECT_EQ(node.wire.poll(), std::nullopt) << "the publisher got a packet";
}

}  // namespace
}  // namespace agnocast
