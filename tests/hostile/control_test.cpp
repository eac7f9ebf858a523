// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever another user says to the daemon, or does not say, the honest pair's own requests are
// answered and its stream goes on; the daemon has its descriptors back when the attacker is gone.
// Method: an attacker of another user for each abuse of the control protocol, for seconds. What one
// user can do to the parser is in integration_daemon_protocol and in fuzz_protocol; here it is what
// comes between two users.

#include <tests/hostile/hostile_node.hpp>

#include <dirent.h>
#include <fcntl.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/un.h>

#include <chrono>
#include <cstring>
#include <thread>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

/// The honest pair beside attacks of several processes at once; afterwards nothing of them is left.
void honest_goes_on_beside(Stage& stage, const std::function<void(Attack&)>& body,
                           unsigned attackers = 1) {
  const std::size_t before = stage.daemon().descriptor_count();
  std::vector<std::unique_ptr<Attacker>> all;
  for (unsigned i = 0; i < attackers; ++i) all.push_back(std::make_unique<Attacker>(body));
  for (const auto& attacker : all) {
    if (!attacker->wait_until_ready()) return;
  }
  const auto end = std::chrono::steady_clock::now() + attack_time();
  unsigned served = 0;
  do {
    stage.honest_goes_on();
    stage.honest_is_served();
    ++served;
  } while (std::chrono::steady_clock::now() < end && !testing::Test::HasFailure());
  std::printf("served %u times beside the attack\n", served);
  for (const auto& attacker : all) attacker->kill();
  all.clear();
  stage.honest_goes_on();
  EXPECT_TRUE(eventually([&] { return stage.daemon().descriptor_count() <= before; }))
      << stage.daemon().descriptor_count() << " descriptors, before the attack " << before;
}

/// A connection on which nothing is expected; none if the daemon turns us away.
PacketSocket connect_to(const std::string& path) {
  auto socket = PacketSocket::connect(path, std::chrono::milliseconds(100));
  return socket ? std::move(*socket) : PacketSocket();
}

template <class Body>
bool say(const PacketSocket& socket, Opcode opcode, Body body, std::span<const int> fds = {}) {
  body.header = {opcode, sizeof body, 1};
  const auto sent = socket.send(std::as_bytes(std::span(&body, 1)), fds);
  return sent && *sent == Sent::sent;
}

TEST(HostileControl, GarbageOfEveryLengthIsTheConcernOfItsSender) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  Chance chance(11);
  const std::string path = stage.socket_path();
  honest_goes_on_beside(stage, [&](Attack& attack) {
    attack.ready();
    while (attack.goes_on()) {
      const PacketSocket socket = connect_to(path);
      if (!socket) continue;
      if (chance.below(2) == 0) {
        wire::Hello hello{};
        hello.fingerprint = abi::fingerprint();
        say(socket, Opcode::hello, hello);
      }
      for (int i = 0; i < 50; ++i) {
        std::vector<std::byte> packet(1 + chance.below(chance.below(8) == 0 ? 60000 : 1100));
        for (std::byte& byte : packet) byte = static_cast<std::byte>(chance());
        if (packet.size() >= sizeof(wire::Header) && chance.below(4) != 0) {
          const wire::Header header{Opcode{static_cast<std::uint32_t>(chance.below(16))},
                                    static_cast<std::uint32_t>(packet.size()), chance()};
          std::memcpy(packet.data(), &header, sizeof header);
        }
        const auto sent = socket.send(packet);
        if (!sent || *sent == Sent::peer_gone) break;
      }
    }
  });
}

TEST(HostileControl, EndlessRequestsOfManyDelayNobodysOwn) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside(
      stage,
      [&](Attack& attack) {
        HostileNode node(path);
        attack.ready();
        // What makes the most work: creations that are refused or carried out, and statements.
        while (attack.goes_on()) {
          for (int i = 0; i < 20; ++i) {
            const Incoming made = node.wire().create_publisher("/flood");
            if (made.opcode() != Opcode::endpoint_created) break;
            const auto body = made.as<wire::EndpointCreated>();
            node.wire().reference(Opcode::leave, Kind::publisher, body.topic, body.index,
                                  body.generation);
            node.wire().reference(Opcode::drained, Kind::publisher, body.topic, body.index,
                                  body.generation);
          }
        }
      },
      4);
}

TEST(HostileControl, WhoNeverReadsItsAnswersIsCutOff) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside(stage, [&](Attack& attack) {
    PacketSocket socket;
    for (attack.ready(); attack.goes_on();) {
      if (!socket) {
        socket = connect_to(path);
        if (!socket) continue;
        wire::Hello hello{};
        hello.fingerprint = abi::fingerprint();
        say(socket, Opcode::hello, hello);
      }
      wire::WindowRequest nonsense{};
      nonsense.window = abi::window_count_max;
      nonsense.header = {Opcode::open_window, sizeof nonsense, 1};
      const auto sent = socket.send(std::as_bytes(std::span(&nonsense, 1)));
      if (!sent || *sent == Sent::peer_gone) {
        socket.close();
        ++attack.word(0);
      }
    }
  });
}

TEST(HostileControl, ConnectionsThatNeverSpeakTakeNobodysPlace) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside(stage, [&](Attack& attack) {
    std::vector<PacketSocket> silent;
    attack.ready();
    while (attack.goes_on()) {
      PacketSocket socket = connect_to(path);
      if (socket) silent.push_back(std::move(socket));
      if (silent.size() > 900) silent.clear();
    }
  });
}

TEST(HostileControl, FloodsOfConnectionsDelayNobodysOwn) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside(
      stage,
      [&](Attack& attack) {
        attack.ready();
        while (attack.goes_on()) {
          const PacketSocket socket = connect_to(path);
          if (!socket) continue;
          wire::Hello hello{};
          hello.fingerprint = abi::fingerprint();
          say(socket, Opcode::hello, hello);
          ++attack.word(0);
        }
      },
      3);
}

TEST(HostileControl, DescriptorsOfStrangeKindsAreClosedUnseen) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside(stage, [&](Attack& attack) {
    int pipe[2];
    ASSERT_EQ(::pipe2(pipe, O_CLOEXEC | O_NONBLOCK), 0);
    std::vector<UniqueFd> strange;
    strange.emplace_back(pipe[0]);
    strange.emplace_back(pipe[1]);
    strange.emplace_back(::epoll_create1(EPOLL_CLOEXEC));
    strange.emplace_back(::eventfd(0, EFD_CLOEXEC));
    strange.emplace_back(::open("/", O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    strange.emplace_back(::open("/", O_PATH | O_CLOEXEC));
    strange.emplace_back(static_cast<int>(::syscall(SYS_memfd_create, "x", 1u)));
    char parameters[120] = {};
    strange.emplace_back(static_cast<int>(::syscall(SYS_io_uring_setup, 4, parameters)));
    strange.emplace_back(static_cast<int>(::syscall(SYS_pidfd_open, ::getpid(), 0)));
    attack.ready();
    while (attack.goes_on()) {
      HostileNode node(path);
      strange.emplace_back(::dup(node.wire().socket().fd()));  // the connection itself
      for (const UniqueFd& one : strange) {
        if (!one) continue;
        const int fds[] = {one.get(), one.get(), one.get(), one.get()};
        for (const std::size_t count : {1u, 4u}) {
          wire::WindowRequest request{};
          request.header = {Opcode::open_window, sizeof request, 99};
          // The kernel itself passes no io_uring and no socket of a socket too deep.
          const auto sent = node.wire().socket().send(std::as_bytes(std::span(&request, 1)),
                                                      std::span(fds).first(count));
          if (!sent || *sent != Sent::sent) continue;
          EXPECT_EQ(node.wire().next().refused_code(), Errc::protocol_violation);
        }
      }
      strange.pop_back();
      EXPECT_EQ(node.wire().open_window(0).opcode(), Opcode::window_opened) << "it may go on";
    }
  });
}

TEST(HostileControl, NothingIsSaidBeforeHelloNorHelloTwice) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  Attacker attacker([&](Attack&) {
    WireClient client(stage.socket_path());
    EXPECT_EQ(client.open_window(0).refused_code(), Errc::protocol_violation);
    EXPECT_EQ(client.open_executor().refused_code(), Errc::protocol_violation);
    EXPECT_EQ(client.create_publisher(open_topic).refused_code(), Errc::protocol_violation);
    EXPECT_EQ(client.create_subscription(open_topic).refused_code(), Errc::protocol_violation);
    for (const Opcode opcode : {Opcode::leave, Opcode::drained})
      EXPECT_EQ(client.reference(opcode, Kind::publisher, 0, 0, 1).refused_code(),
                Errc::protocol_violation);
    client.unlinked(Kind::region, 0, 0, 1);
    EXPECT_EQ(client.next().refused_code(), Errc::protocol_violation);
    EXPECT_EQ(client.ask(Opcode::dump, wire::Dump{}).refused_code(), Errc::protocol_violation);
    wire::Revoke revoke{};
    revoke.generation = 1;
    EXPECT_EQ(client.ask(Opcode::revoke, revoke).refused_code(), Errc::protocol_violation);
    EXPECT_EQ(client.hello().opcode(), Opcode::welcome);
    EXPECT_EQ(client.ask(Opcode::revoke, revoke).refused_code(), Errc::protocol_violation);
    EXPECT_EQ(client.hello().refused_code(), Errc::protocol_violation);
    wire::Observe observe{};
    observe.fingerprint = abi::fingerprint();
    EXPECT_EQ(client.ask(Opcode::observe, observe).refused_code(), Errc::protocol_violation);
    EXPECT_EQ(client.ask(Opcode::dump, wire::Dump{}).refused_code(), Errc::protocol_violation);
  });
  attacker.end();
  stage.honest_goes_on();
}

// It can see every number of everybody (observers can), and claims them all.
TEST(HostileControl, ClaimsAboutOthersEndpointsChangeNothing) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside(stage, [&](Attack& attack) {
    HostileNode node(path);
    node.join(Kind::subscription, stream_topic);
    node.join(Kind::publisher, open_topic);
    WireClient observer(path);
    wire::Observe observe{};
    observe.fingerprint = abi::fingerprint();
    ASSERT_EQ(observer.ask(Opcode::observe, observe).opcode(), Opcode::observed);
    attack.ready();
    while (attack.goes_on()) {
      std::vector<wire::DumpEndpoint> endpoints;
      std::vector<wire::DumpProcess> processes;
      observer.send(Opcode::dump, wire::Dump{});
      for (;;) {
        const Incoming packet = observer.next();
        if (packet.opcode() == Opcode::dump_endpoint)
          endpoints.push_back(packet.as<wire::DumpEndpoint>());
        if (packet.opcode() == Opcode::dump_process)
          processes.push_back(packet.as<wire::DumpProcess>());
        if (packet.bytes.empty() || packet.opcode() == Opcode::dump_end) break;
      }
      ASSERT_GE(endpoints.size(), 5u);
      for (const auto& endpoint : endpoints) {
        if (endpoint.client == node.welcome().client) continue;
        for (const Opcode opcode : {Opcode::leave, Opcode::drained})
          EXPECT_EQ(node.wire()
                        .reference(opcode, endpoint.kind, endpoint.topic, endpoint.index,
                                   endpoint.generation)
                        .refused_code(),
                    Errc::protocol_violation);
        // Of what it was told it may say so, and loses it; of the rest it means nothing.
        node.wire().unlinked(endpoint.kind, endpoint.topic, endpoint.index, endpoint.generation);
      }
      for (const auto& process : processes) {
        node.wire().unlinked(Kind::region, 0, process.client, process.generation);
        if (process.client == node.welcome().client) continue;
        WireClient impostor(path);
        wire::Rejoin rejoin{};
        rejoin.fingerprint = abi::fingerprint();
        rejoin.incarnation = node.welcome().incarnation;
        rejoin.client = process.client;
        rejoin.client_generation = process.generation;
        EXPECT_EQ(impostor.ask(Opcode::rejoin, rejoin).opcode(), Opcode::refused)
            << "somebody else's place";
        wire::Revoke revoke{};
        revoke.client = process.client;
        revoke.generation = process.generation;
        EXPECT_EQ(observer.ask(Opcode::revoke, revoke).refused_code(), Errc::permission_denied)
            << "of another user";
        revoke.generation += 1;
        EXPECT_EQ(observer.ask(Opcode::revoke, revoke).refused_code(), Errc::endpoint_gone);
      }
      node.wire().drain();
    }
  });
}

TEST(HostileControl, ObserversThatAskWithoutEndAreCutOff) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside(stage, [&](Attack& attack) {
    std::vector<PacketSocket> observers;
    attack.ready();
    while (attack.goes_on()) {
      while (observers.size() < abi::observer_count_max + 4) {
        PacketSocket socket = connect_to(path);
        if (!socket) break;
        wire::Observe observe{};
        observe.fingerprint = abi::fingerprint();
        say(socket, Opcode::observe, observe);
        observers.push_back(std::move(socket));
      }
      for (auto at = observers.begin(); at != observers.end();) {
        if (say(*at, Opcode::dump, wire::Dump{})) {
          ++at;
        } else {
          at = observers.erase(at);
          ++attack.word(0);
        }
      }
    }
  });
}

}  // namespace
}  // namespace agnocast::test
