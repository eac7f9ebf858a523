// SPDX-License-Identifier: Apache-2.0
//
// Goal: a client that does not read the daemon's packets, or causes many of them, costs it no more
// than one user may cost and is delayed or disconnected with a reason, and all other clients go
// on.
// Method: an attacker of another user with small quotas asks without reading, stops reading, and
// asks for dumps as fast as it can, beside the honest pair.

#include <tests/hostile/hostile_node.hpp>

#include <memory>
#include <thread>
#include <vector>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

constexpr std::size_t mib = std::size_t{1} << 20;

std::size_t private_bytes(const DaemonProcess& daemon) {
  return daemon.resident_bytes() - daemon.shared_bytes();
}

/// Sends a request that is refused at length; false when the connection is over.
bool ask_nonsense(WireClient& client) {
  wire::WindowRequest nonsense{};
  nonsense.header = {Opcode::open_window, sizeof nonsense, 1};
  nonsense.window = abi::window_count_max;
  return client.send_bytes(std::as_bytes(std::span(&nonsense, 1)));
}

WireClient observer_at(const std::string& path) {
  WireClient observer(path);
  wire::Observe observe{};
  observe.fingerprint = abi::fingerprint();
  EXPECT_EQ(observer.ask(Opcode::observe, observe).opcode(), Opcode::observed);
  return observer;
}

TEST(HostileUnread, ManyClientsThatDoNotReadCostNoMoreThanOneUserMay) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = "held_messages = 400\nqueued_bytes = \"2MiB\"\n"});
  stage.honest_goes_on();
  const std::size_t before = private_bytes(stage.daemon());
  Attacker attacker([&](Attack& attack) {
    std::vector<std::unique_ptr<WireClient>> clients(20);
    while (attack.goes_on()) {
      for (auto& client : clients) {
        if (client == nullptr) {
          client = std::make_unique<WireClient>(stage.socket_path());
          static_cast<void>(client->hello());
        }
        for (int i = 0; i < 100 && client != nullptr; ++i) {
          if (ask_nonsense(*client)) continue;
          client = nullptr;
          if (++attack.word(0) == 3) attack.ready();
        }
      }
    }
  });
  ASSERT_TRUE(attacker.wait_until_ready()) << "no client was disconnected";
  std::size_t most = 0;
  for (int i = 0; i < 5; ++i) {
    stage.honest_goes_on();
    most = std::max(most, private_bytes(stage.daemon()));
  }
  stage.honest_is_served();
  EXPECT_LT(most, before + 24 * mib);
  attacker.kill();
  EXPECT_TRUE(stage.daemon().wait_for_log("[quota] queued_bytes is 2097152"));
  EXPECT_TRUE(eventually([&] { return private_bytes(stage.daemon()) < before + 8 * mib; }))
      << "the daemon did not free the memory";
  stage.honest_lost_nothing();
}

TEST(HostileUnread, AClientThatStopsReadingIsDisconnectedAndMayRejoin) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = "held_messages = 400\nqueued_seconds = 1\n"});
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    for (int i = 0; i < 3000; ++i) EXPECT_TRUE(ask_nonsense(node.wire()));
    attack.ready();
    EXPECT_TRUE(eventually([&] { return !ask_nonsense(node.wire()); }));
    // Its session continues as before.
    EXPECT_TRUE(eventually([&] {
      WireClient again(stage.socket_path());
      return again.rejoin(node.welcome()).opcode() == Opcode::rejoined;
    }));
    while (attack.goes_on()) ::usleep(5000);
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  EXPECT_TRUE(stage.daemon().wait_for_log("[quota] queued_seconds is 1"));
  const std::string log = stage.daemon().log();
  EXPECT_NE(log.find("connection ended pid=" + std::to_string(attacker.pid()) +
                     " uid=" + std::to_string(hostile_uid)),
            std::string::npos)
      << log;
  stage.honest_is_served();
  attacker.end();
  stage.honest_lost_nothing();
}

TEST(HostileUnread, AnObserverThatAsksTooOftenWaitsAndIsAnswered) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = "held_messages = 400\ndumps_per_second = 5\n"});
  Attacker attacker([&](Attack& attack) {
    WireClient observer = observer_at(stage.socket_path());
    const auto begin = std::chrono::steady_clock::now();
    attack.ready();
    for (int i = 0; i < 20; ++i) {
      observer.send(Opcode::dump, wire::Dump{});
      for (;;) {
        const Incoming packet = observer.next();
        ASSERT_FALSE(packet.bytes.empty()) << "answer " << i;
        ASSERT_NE(packet.opcode(), Opcode::refused) << packet.refused_text();
        if (packet.opcode() == Opcode::dump_end) break;
      }
    }
    // Five at once and five a second; a slow machine takes longer.
    EXPECT_GE(std::chrono::steady_clock::now() - begin, std::chrono::milliseconds(2500));
    // A client that does not wait for its answer is disconnected, as ever.
    wire::Dump dump{};
    dump.header = {Opcode::dump, sizeof dump, 1};
    for (int i = 0; i < 8; ++i)
      static_cast<void>(observer.send_bytes(std::as_bytes(std::span(&dump, 1))));
    EXPECT_TRUE(observer.is_hung_up());
    while (attack.goes_on()) ::usleep(5000);
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  for (int i = 0; i < 3; ++i) EXPECT_GT(stage.counters().clients_registered, 0u);
  stage.honest_is_served();
  attacker.end();
  stage.honest_lost_nothing();
}

}  // namespace
}  // namespace agnocast::test
