// SPDX-License-Identifier: Apache-2.0
//
// Goal: the end of a connection ends no session; the end of a process does, once; a revoked process
// keeps its place until it ends. Method: the daemon's core with peers without sockets, and a log
// that the test reads.

#include <daemon/death/client_termination.hpp>
#include <tests/support/processes/daemon_core.hpp>
#include <tests/unit/daemon/admission/users.hpp>

#include <gtest/gtest.h>

#include <unistd.h>

#include <memory>
#include <string>
#include <utility>

namespace agnocast::daemon {
namespace {

class ClientTerminationTest : public testing::Test {
 protected:
  /// A connection without a session.
  Peer& stranger() {
    PeerIdentity identity;
    identity.uid = alice;
    identity.pid = ::getpid();
    auto peer = std::make_unique<Peer>(
        Peer{connections.next_id(), Session(PacketSocket(), std::move(identity))});
    peer->session.set_may_carry(false);  // there is no socket to close
    return connections.add(std::move(peer));
  }
  /// A process with a publisher; no process maps its region.
  Peer& member() {
    const ClientIndex client = core.process(alice);
    core.create(client, Kind::publisher, "/" + std::to_string(number(client)));
    Peer& peer = stranger();
    peer.session.greet(client);
    connections.set_client(client, &peer);
    return peer;
  }
  /// Runs the loop's cycles until each end is complete: one cycle may not suffice on a busy
  /// machine.
  void complete() {
    while (!reaping.is_empty()) reaping.go_on();
  }
  bool has_logged(const std::string& text) const { return lines.find(text) != std::string::npos; }

  test::DaemonCore core;
  Dispatcher dispatcher = std::move(Dispatcher::create().value());
  std::unique_ptr<Errands> errands = std::move(Errands::create(dispatcher).value());
  Disposal disposal{*errands};
  ConnectionTable connections{dispatcher, disposal};
  Obstacles obstacles{Arena{std::uint64_t{1} << 45, 16 << 20, 2 << 20}};
  ReapingQueue reaping{core.registry, core.regions, core.doorbells, core.endpoint_manager};
  RegionLook region_look{connections, *errands, core.regions};
  std::string lines;
  Log log{{"agnocastd"},
          LogLevel::debug,
          Log::Format::people,
          [this](std::string_view line) { return lines.append(line), true; },
          [] { return std::uint64_t{0}; }};
  ClientTermination termination{connections, dispatcher,  core.registry,
                                core.store,  obstacles,   core.endpoint_manager,
                                reaping,     region_look, log};
};

TEST_F(ClientTerminationTest, AConnectionWithoutASessionLeavesNothing) {
  const PeerId id = stranger().id;
  termination.disconnect(*connections.find(id), "test");
  EXPECT_EQ(connections.find(id), nullptr);
  EXPECT_EQ(core.registry.client_high(), 0u);
}

TEST_F(ClientTerminationTest, AProcessThatLosesItsConnectionKeepsItsSession) {
  Peer& peer = member();
  const ClientIndex client = *peer.session.client();
  termination.disconnect(peer, "test");
  EXPECT_TRUE(peer.detached);
  EXPECT_EQ(connections.of_client(client), &peer);
  EXPECT_TRUE(core.registry.is_alive(client));
  EXPECT_EQ(core.registry.endpoints_of(client).size(), 1u);
}

TEST_F(ClientTerminationTest, AProcessThatEndsIsReapedAndItsPlaceIsFreed) {
  Peer& peer = member();
  const PeerId id = peer.id;
  const ClientIndex client = *peer.session.client();
  peer.ended = true;
  termination.disconnect(peer, "test");
  termination.reap(peer, journal::DeathReason::died, "process ended");
  complete();
  EXPECT_EQ(connections.find(id), nullptr);
  EXPECT_EQ(connections.of_client(client), nullptr);
  EXPECT_EQ(core.registry.client(client).state, ClientState::free);
  EXPECT_TRUE(has_logged("client gone")) << lines;
}

TEST_F(ClientTerminationTest, ARevokedProcessKeepsItsPlaceUntilItEnds) {
  Peer& peer = member();
  const PeerId id = peer.id;
  const ClientIndex client = *peer.session.client();
  termination.revoke(peer, "test");
  complete();
  EXPECT_EQ(connections.of_client(client), nullptr) << "it has no session";
  ASSERT_EQ(connections.find(id), &peer) << "and the daemon watches it";
  EXPECT_TRUE(core.registry.is_revoked(client));
  EXPECT_EQ(core.registry.client(client).state, ClientState::forgotten);
  EXPECT_TRUE(core.registry.endpoints_of(client).empty());
  EXPECT_TRUE(has_logged("client revoked")) << lines;
  termination.reap(peer, journal::DeathReason::died, "process ended");
  complete();
  EXPECT_EQ(connections.find(id), nullptr);
  EXPECT_EQ(core.registry.client(client).state, ClientState::free);
  EXPECT_EQ(core.registry.counters().clients_revoked, 1u);
}

TEST_F(ClientTerminationTest, TheEndOfAProcessWithoutASessionIsNoDeath) {
  Peer& peer = stranger();
  const PeerId id = peer.id;
  termination.reap(peer, journal::DeathReason::died, "process ended");
  complete();
  EXPECT_EQ(connections.find(id), nullptr);
  EXPECT_FALSE(has_logged("client gone"));
}

TEST_F(ClientTerminationTest, TheOccupiedRangesOfAClientGoWithIt) {
  Peer& peer = member();
  const ClientIndex client = *peer.session.client();
  ASSERT_TRUE(obstacles.add(client, alice, std::uint64_t{1} << 45, 4096, "a library"));
  termination.reap(client, journal::DeathReason::died, "ended while the daemon was away",
                   UINT64_MAX);
  complete();
  EXPECT_TRUE(obstacles.of(client).empty());
}

}  // namespace
}  // namespace agnocast::daemon
