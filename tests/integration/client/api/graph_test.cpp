// SPDX-License-Identifier: Apache-2.0
//
// Goal: agnocast::Graph reports how every endpoint was created, reports again when something has
// changed and only then, in any incarnation of the daemon, and disturbs nobody. Method: the real
// daemon; endpoints of raw clients (CtlNode), so that the test determines every fact.

#include <agnocast/graph.hpp>
#include <tests/integration/ctl/ctl_node.hpp>
#include <tests/support/node_process.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/wire/wire_dump.hpp>

#include <gmock/gmock.h>

#include <chrono>
#include <cstdlib>
#include <optional>
#include <string>
#include <thread>
#include <vector>

namespace agnocast {
namespace {

using namespace std::chrono_literals;
using test::CtlNode;
using test::DaemonProcess;
using test::NodeProcess;
using testing::ElementsAre;
using testing::IsEmpty;
using testing::SizeIs;

// Only a failing test waits this long.
constexpr auto patience = 5min;

class GraphTest : public testing::Test {
 protected:
  void SetUp() override { ::setenv("AGNOCAST_SOCKET", daemon_.socket_path().c_str(), 1); }
  void TearDown() override { ::unsetenv("AGNOCAST_SOCKET"); }

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

  DaemonProcess daemon_;
  Graph graph_;
};

TEST_F(GraphTest, ReportsHowEveryEndpointWasCreated) {
  CtlNode talker(daemon_.socket_path(), 0, "talker_process"),
      listener(daemon_.socket_path(), 7, "listener_process");
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

  const GraphSnapshot now = changed();
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
  EXPECT_EQ(now.incarnation, test::wire_dump(daemon_.socket_path()).incarnation);
}

TEST_F(GraphTest, ReportsAgainWhenAnEndpointComesLeavesOrDies) {
  EXPECT_THAT(changed().endpoints, IsEmpty());
  nothing_changes();
  CtlNode node(daemon_.socket_path());
  const auto publisher = node.publisher("/points");
  EXPECT_EQ(until_there_are(1).endpoints[0].generation, publisher.generation);
  node.subscription("/points");
  until_there_are(2);
  nothing_changes();

  NodeProcess other(daemon_.socket_path(), [](CtlNode& process) { process.publisher("/others"); });
  const GraphSnapshot three = until_there_are(3);
  EXPECT_EQ(three.endpoints[2].topic, "/others");
  EXPECT_EQ(three.endpoints[2].pid, static_cast<std::uint32_t>(other.pid()));
  EXPECT_NE(three.endpoints[2].client, three.endpoints[0].client);
  other.kill();
  other.wait();
  until_there_are(2);
  node.wire.reference(abi::wire::Opcode::leave, abi::wire::Kind::publisher, publisher.topic,
                      publisher.index, publisher.generation);
  EXPECT_EQ(until_there_are(1).endpoints[0].kind, EndpointKind::subscription);
}

TEST_F(GraphTest, WakesForAChangeWhileItWaits) {
  EXPECT_THAT(changed().endpoints, IsEmpty());
  std::optional<CtlNode> node;
  std::thread comes([&] {
    node.emplace(daemon_.socket_path());
    node->publisher("/points");
  });
  until_there_are(1);
  comes.join();
}

TEST_F(GraphTest, EndsItsWaitWhenInterruptedAndLosesNothing) {
  EXPECT_THAT(changed().endpoints, IsEmpty());
  std::thread interrupts([&] { graph_.interrupt(); });
  const auto ended = graph_.wait(patience);
  interrupts.join();
  ASSERT_TRUE(ended) << ended.error().what;
  EXPECT_FALSE(*ended);
  graph_.interrupt();  // before the next wait
  EXPECT_FALSE(graph_.wait(patience).value());
  CtlNode node(daemon_.socket_path());
  node.publisher("/points");
  until_there_are(1);
}

TEST_F(GraphTest, GoesOnAfterARestartOfTheDaemon) {
  CtlNode node(daemon_.socket_path());
  const auto publisher = node.publisher("/points");
  const std::uint64_t incarnation = changed().incarnation;
  daemon_.kill_worker();
  // Its supervisor starts the next daemon, which has the same tables.
  const GraphSnapshot again =
      changed_until([](const GraphSnapshot& now) { return now.endpoints.size() == 1; });
  EXPECT_EQ(again.incarnation, incarnation);
  EXPECT_EQ(again.endpoints[0].generation, publisher.generation);
}

TEST_F(GraphTest, IsNoEndpointAndChangesNothing) {
  CtlNode node(daemon_.socket_path());
  node.publisher("/points");
  const auto before = test::wire_dump(daemon_.socket_path());
  EXPECT_THAT(changed().endpoints, SizeIs(1));
  nothing_changes();
  const auto after = test::wire_dump(daemon_.socket_path());
  EXPECT_EQ(after.processes.size(), before.processes.size());
  EXPECT_EQ(after.endpoints.size(), before.endpoints.size());
  EXPECT_EQ(node.wire.poll(), std::nullopt) << "the publisher got a packet";
}

TEST(Graph, ReportsAMissingDaemonAndConnectsOnceOneRuns) {
  const std::string directory = test::make_directory();
  const std::string socket = directory + "/agnocastd.sock";
  ::setenv("AGNOCAST_SOCKET", socket.c_str(), 1);
  Graph graph;
  const auto nobody = graph.wait(1s);
  ASSERT_FALSE(nobody);
  EXPECT_EQ(nobody.error().code, Errc::daemon_not_running);
  {
    DaemonProcess daemon({.socket = socket});
    const auto somebody = graph.wait(1s);
    ASSERT_TRUE(somebody) << somebody.error().what;
    ASSERT_TRUE(*somebody);
    EXPECT_THAT((*somebody)->endpoints, IsEmpty());
  }
  const auto gone = graph.wait(1s);
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().code, Errc::daemon_not_running);
  ::unsetenv("AGNOCAST_SOCKET");
  test::remove_directory(directory);
}

}  // namespace
}  // namespace agnocast
