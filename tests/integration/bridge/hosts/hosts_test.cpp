// SPDX-License-Identifier: Apache-2.0
//
// Goal: a message published on one host arrives on another as if there were no bridges between,
// once and in order, also after any process dies or the cable is unplugged. Method: two network
// namespaces as two hosts; a veth pair, real SIGKILL.

#include <tests/integration/bridge/hosts/hosts.hpp>

#include <gmock/gmock.h>

#include <chrono>
#include <thread>

namespace agnocast::test {
namespace {

using namespace std::chrono_literals;
using testing::SizeIs;

/// A publisher "p" on the left and a subscription "s" on the right, of one topic.
struct Flow {
  explicit Flow(const std::string& lease, const std::string& qos = "1000") : hosts(lease) {
    hosts.left.start_bridge();
    hosts.right.start_bridge();
    from = hosts.left.process();
    to = hosts.right.process();
    EXPECT_EQ(from->ask("pub p /flow " + qos), "made");
    EXPECT_EQ(to->ask("sub s /flow " + qos), "made");
  }
  /// Publishes one more message; returns true when one published since the call with the same
  /// `since` has arrived.
  bool goes_on(std::uint64_t since) {
    publish();
    heard.take(*to, "s");
    return heard.has("p", since);
  }
  void publish() {
    EXPECT_EQ(from->ask("publish p 1"), "published");
    ++count;
  }
  bool flows() {
    const std::uint64_t since = count;
    return eventually_s([&] { return goes_on(since); });
  }

  TwoHosts hosts;
  std::unique_ptr<SteeredProcess> from, to;
  Heard heard;
  std::uint64_t count = 0;  // published
};

TEST_F(Hosts, ExchangeOneTopicBothWaysOnceEachAndPublishersKeepTheirIdentity) {
  TwoHosts hosts;
  hosts.left.start_bridge();
  hosts.right.start_bridge();
  const auto left = hosts.left.process(), right = hosts.right.process();
  ASSERT_EQ(left->ask("sub s /both 1000"), "made");
  ASSERT_EQ(right->ask("sub s /both 1000"), "made");
  for (const char* const name : {"l1", "l2"})
    ASSERT_EQ(left->ask(std::string("pub ") + name + " /both 1000"), "made");
  for (const char* const name : {"r1", "r2", "r3"})
    ASSERT_EQ(right->ask(std::string("pub ") + name + " /both 1000"), "made");
  Heard on_left, on_right;
  const auto publish_all = [&](int each) {
    for (const char* const name : {"l1", "l2"})
      EXPECT_EQ(left->ask(std::string("publish ") + name + " " + std::to_string(each)),
                "published");
    for (const char* const name : {"r1", "r2", "r3"})
      EXPECT_EQ(right->ask(std::string("publish ") + name + " " + std::to_string(each)),
                "published");
  };
  ASSERT_TRUE(eventually_s([&] {
    publish_all(1);
    on_left.take(*left, "s");
    on_right.take(*right, "s");
    return on_left.numbers.size() == 5 && on_right.numbers.size() == 5;
  }));
  std::uint64_t last = 0;
  for (const auto& [name, numbers] : on_left.numbers) last = std::max(last, numbers.back());
  publish_all(100);
  ASSERT_TRUE(eventually_s([&] {
    on_left.take(*left, "s");
    on_right.take(*right, "s");
    bool is_all = true;
    for (const char* const name : {"l1", "l2", "r1", "r2", "r3"})
      is_all &= on_left.has(name, last + 100) && on_right.has(name, last + 100);
    return is_all;
  }));
  for (const Heard* const heard : {&on_left, &on_right}) {
    EXPECT_TRUE(heard->is_once_and_in_order());
    std::set<std::string> publishers;
    for (const auto& [name, of] : heard->publishers) {
      EXPECT_TRUE(heard->is_complete(name)) << name;
      EXPECT_THAT(of, SizeIs(1)) << name;
      publishers.insert(of.begin(), of.end());
    }
    EXPECT_THAT(publishers, SizeIs(5));
  }
  expect_sound(hosts.left);
  expect_sound(hosts.right);
}

TEST_F(Hosts, KeepToThemselvesWhatRosLocalhostOnlySays) {
  for (const bool is_localhost_only : {false, true}) {
    TwoHosts hosts;
    hosts.left.start_plain_bridge(
        {std::string("ROS_LOCALHOST_ONLY=") + (is_localhost_only ? "1" : "0"), "ROS_DISTRO=humble",
         "CYCLONEDDS_URI="});
    hosts.right.start_plain_bridge({"ROS_LOCALHOST_ONLY=0", "CYCLONEDDS_URI="});
    const auto from = hosts.left.process(), right = hosts.right.process();
    // As rmw_cyclonedds_cpp of Humble sets up a node with ROS_LOCALHOST_ONLY=1.
    SteeredProcess node(
        {"/usr/bin/nsenter", "--net=" + hosts.left.network().path(), AGNOCAST_TEST_PLAIN_PEER, "0"},
        {"CYCLONEDDS_URI=<CycloneDDS><Domain><General><Interfaces><NetworkInterface "
         "address='127.0.0.1'/></Interfaces></General></Domain></CycloneDDS>"});
    ASSERT_EQ(node.ask("reader s rt/local String reliable 1000"), "made");
    ASSERT_EQ(right->ask("sub s /local 1000"), "made");
    ASSERT_EQ(from->ask("pub p /local 1000"), "made");
    Heard on_right;
    std::size_t by_node = 0;
    ASSERT_TRUE(eventually_s([&] {
      EXPECT_EQ(from->ask("publish p 1"), "published");
      if (node.ask("take s") != "none") ++by_node;
      on_right.take(*right, "s");
      return is_localhost_only ? by_node > 50 : on_right.has("p", 50);
    }));
    EXPECT_EQ(on_right.numbers.empty(), is_localhost_only);
    EXPECT_EQ(by_node == 0, !is_localhost_only);
  }
}

TEST_F(Hosts, KeepDomainsApart) {
  TwoHosts hosts;
  std::vector<std::unique_ptr<SteeredProcess>> from, to;
  for (const std::uint32_t domain : {3u, 4u}) {
    hosts.left.start_bridge(domain);
    hosts.right.start_bridge(domain);
    from.push_back(hosts.left.process(domain));
    to.push_back(hosts.right.process(domain));
    ASSERT_EQ(from.back()->ask("pub of" + std::to_string(domain) + " /same 1000"), "made");
    ASSERT_EQ(to.back()->ask("sub s /same 1000"), "made");
  }
  Heard heard[2];
  ASSERT_TRUE(eventually_s([&] {
    for (std::size_t i = 0; i < 2; ++i) {
      EXPECT_EQ(from[i]->ask("publish of" + std::to_string(3 + i) + " 1"), "published");
      heard[i].take(*to[i], "s");
    }
    return heard[0].has("of3", 20) && heard[1].has("of4", 20);
  }));
  EXPECT_THAT(heard[0].numbers, SizeIs(1));
  EXPECT_THAT(heard[1].numbers, SizeIs(1));
}

TEST_F(Hosts, LoseNothingReliableWhileTheNetworkIsGoneForLessThanTheLease) {
  Flow flow("60 s");
  ASSERT_TRUE(flow.flows());
  flow.hosts.unplug();
  for (int i = 0; i < 200; ++i) flow.publish();
  std::this_thread::sleep_for(500ms);
  flow.hosts.plug();
  EXPECT_TRUE(flow.flows());
  EXPECT_TRUE(flow.heard.is_once_and_in_order());
  EXPECT_TRUE(flow.heard.is_complete("p"));
  EXPECT_THAT(flow.heard.publishers["p"], SizeIs(1));
}

TEST_F(Hosts, RecoverAfterTheNetworkWasGoneForLongerThanTheLease) {
  Flow flow("1 s");
  ASSERT_TRUE(flow.flows());
  const Held before = held_by(flow.hosts.left.bridge().pid());
  for (int round = 0; round < 2; ++round) {
    flow.hosts.unplug();
    // The publisher that stands for the writer goes when the lease ends.
    ASSERT_TRUE(eventually_s([&] {
      flow.publish();
      const CtlResult info =
          run_ctl(flow.hosts.right.daemon().socket_path(), {"topic", "info", "/flow"});
      return info.out.find("Publisher count: 0") != std::string::npos;
    }));
    flow.hosts.plug();
    EXPECT_TRUE(flow.flows());
  }
  EXPECT_TRUE(flow.heard.is_once_and_in_order());
  const Held after = held_by(flow.hosts.left.bridge().pid());
  EXPECT_LE(after.descriptors, before.descriptors);
  EXPECT_LE(after.threads, before.threads);
  expect_sound(flow.hosts.left);
  expect_sound(flow.hosts.right);
}

TEST_F(Hosts, RecoverAfterBridgesAndDaemonsWereKilledAndLeaveNothingBehind) {
  Flow flow("1 s");
  ASSERT_TRUE(flow.flows());
  const auto settled = [&](pid_t pid) {
    Held held = held_by(pid);
    // Threads of Cyclone DDS and of the library end by themselves.
    (void)eventually([&] {
      const Held now = held_by(pid);
      const bool same = now.descriptors == held.descriptors && now.threads == held.threads;
      held = now;
      return same;
    });
    return held;
  };
  const pid_t left_bridge = flow.hosts.left.bridge().pid();
  const Held bridge_before = settled(left_bridge);
  const Held right_before = settled(flow.hosts.right.daemon().pid());
  for (int round = 0; round < 3; ++round) {
    flow.hosts.right.bridge().kill();
    flow.publish();
    flow.hosts.right.start_bridge();
    EXPECT_TRUE(flow.flows()) << "remote bridge, round " << round;
  }
  const auto is_as_before = [](const Held& now, const Held& before) {
    return now.descriptors <= before.descriptors && now.threads <= before.threads;
  };
  EXPECT_TRUE(eventually_s([&] { return is_as_before(held_by(left_bridge), bridge_before); }))
      << held_by(left_bridge).descriptors << " descriptors, before " << bridge_before.descriptors;
  EXPECT_LT(held_by(left_bridge).anonymous_kib, bridge_before.anonymous_kib + 8 * 1024);
  EXPECT_TRUE(eventually_s(
      [&] { return is_as_before(held_by(flow.hosts.right.daemon().pid()), right_before); }));
  EXPECT_TRUE(flow.heard.is_once_and_in_order());

  for (int round = 0; round < 2; ++round) {
    flow.hosts.left.bridge().kill();
    flow.publish();
    flow.hosts.left.start_bridge();
    EXPECT_TRUE(flow.flows()) << "local bridge, round " << round;
  }
  EXPECT_TRUE(flow.heard.is_once_and_in_order());

  // Without a daemon messages flow on: nothing is lost at all.
  flow.heard = {};
  for (Host* const host : {&flow.hosts.left, &flow.hosts.right}) {
    const pid_t killed = host->daemon().kill_worker();
    EXPECT_TRUE(flow.flows());
    ASSERT_TRUE(host->daemon().wait_for_next(killed));
    EXPECT_TRUE(flow.flows());
  }
  EXPECT_TRUE(flow.heard.is_once_and_in_order());
  EXPECT_TRUE(flow.heard.is_complete("p"));
  // Endpoints created afterwards are bridged as before.
  ASSERT_EQ(flow.from->ask("pub p2 /flow 1000"), "made");
  EXPECT_TRUE(eventually_s([&] {
    EXPECT_EQ(flow.from->ask("publish p2 1"), "published");
    flow.heard.take(*flow.to, "s");
    return flow.heard.has("p2", 0);
  }));
  expect_sound(flow.hosts.left);
  expect_sound(flow.hosts.right);
}

}  // namespace
}  // namespace agnocast::test
