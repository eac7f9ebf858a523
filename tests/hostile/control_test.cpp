// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever another user sends or does not send to the daemon, it answers the honest pair's
// own requests and the stream goes on; the daemon has its descriptors back when the attacker is
// gone.
// Method: for each abuse of the control protocol, an attacker of another user runs for seconds.
// The parser's part is in integration_daemon_protocol and fuzz_protocol; this file covers what one
// user can do to another.

#include <tests/hostile/hostile_node.hpp>

#include <dirent.h>
#include <fcntl.h>
#include <poll.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/un.h>

#include <array>
#include <chrono>
#include <csignal>
#include <cstring>
#include <thread>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

/// Runs the honest pair beside attacks of several processes at once; afterwards nothing of them is
/// left. With `cut_off` the attackers count in their first word how often the daemon ended their
/// connection; the daemon has to do so repeatedly.
enum class Ends : std::uint8_t { any, cut_off };
void honest_goes_on_beside_many(Stage& stage, const std::function<void(Attack&)>& body,
                                unsigned attackers = 1, Ends ends = Ends::any) {
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
  for (const auto& attacker : all) {
    if (ends == Ends::cut_off) {
      EXPECT_TRUE(eventually([&] { return attacker->word(0) >= 3; }))
          << "cut off " << attacker->word(0) << " times";
    }
  }
  for (const auto& attacker : all) attacker->kill();
  all.clear();
  stage.honest_goes_on();
  EXPECT_TRUE(eventually([&] { return stage.daemon().descriptor_count() <= before; }))
      << stage.daemon().descriptor_count() << " descriptors, before the attack " << before;
}

/// Connects without a further packet. Returns an empty socket if the daemon turns us away.
PacketSocket connect_to(const std::string& path) {
  auto socket = PacketSocket::connect(path, std::chrono::milliseconds(100));
  return socket ? std::move(*socket) : PacketSocket();
}

template <class Body>
bool say_to(const PacketSocket& socket, Opcode opcode, Body body, std::span<const int> fds = {}) {
  body.header = {opcode, sizeof body, 1};
  const auto sent = socket.send(std::as_bytes(std::span(&body, 1)), fds);
  return sent && *sent == Sent::sent;
}

TEST(HostileControl, GarbageOfEveryLengthAffectsOnlyItsSender) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  Chance chance(11);
  const std::string path = stage.socket_path();
  honest_goes_on_beside_many(stage, [&](Attack& attack) {
    attack.ready();
    while (attack.goes_on()) {
      const PacketSocket socket = connect_to(path);
      if (!socket) continue;
      if (chance.below(2) == 0) {
        wire::Hello hello{};
        hello.fingerprint = abi::fingerprint();
        say_to(socket, Opcode::hello, hello);
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

void come_and_go(WireClient& client) {
  const Incoming made = client.create_publisher("/flood");
  if (made.opcode() != Opcode::endpoint_created) return;
  const auto body = made.as<wire::EndpointCreated>();
  for (const Opcode opcode : {Opcode::leave, Opcode::drained})
    client.reference(opcode, Kind::publisher, body.topic, body.index, body.generation);
}

TEST(HostileControl, EndlessRequestsOfManyProcessesDelayNoOtherUser) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside_many(
      stage,
      [&](Attack& attack) {
        HostileNode node(path);
        attack.ready();
        // The requests that cause the most work: creations, refused or carried out, and
        // statements.
        while (attack.goes_on()) come_and_go(node.wire());
      },
      4);
}

TEST(HostileControl, ACrowdThatWatchesTheGraphDelaysNoOtherUser) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  // The daemon keeps the table, once it has made it.
  EXPECT_EQ(HostileNode(path).wire().ask(Opcode::watch_graph, wire::WatchGraph{}).fds.size(), 1u);
  honest_goes_on_beside_many(
      stage,
      [&](Attack& attack) {
        std::vector<std::unique_ptr<HostileNode>> crowd;
        for (int i = 0; i < 60; ++i) crowd.push_back(std::make_unique<HostileNode>(path));
        attack.ready();
        // One endpoint that comes and goes concerns all of them. Some never read what they get,
        // some want the table again and again.
        for (std::uint64_t round = 0; attack.goes_on(); ++round) {
          come_and_go(crowd[0]->wire());
          for (std::size_t i = 0; i < crowd.size(); ++i) {
            wire::WatchGraph request{};
            request.table = round % 4 == 0 ? 0 : attack.word(1).load();
            if (!say_to(crowd[i]->wire().socket(), Opcode::watch_graph, request))
              crowd[i] = std::make_unique<HostileNode>(path);
            while (i % 3 != 0) {
              const auto packet = crowd[i]->wire().poll();
              if (!packet) break;
              if (packet->opcode() == Opcode::graph_changed)
                attack.word(1) = packet->as<wire::GraphChanged>().table;
            }
          }
        }
      },
      2);
}

/// Connects an accepted observer, to ask for counters later.
std::unique_ptr<WireClient> observer_of(const std::string& path) {
  auto client = std::make_unique<WireClient>(path);
  wire::Observe observe{};
  observe.fingerprint = abi::fingerprint();
  EXPECT_EQ(client->ask(Opcode::observe, observe).opcode(), Opcode::observed);
  return client;
}

// While the daemon is stopped, all clients send their requests: several hundred connections of one
// user a long row each, and last two connections of another user one each. The second of these
// asks how many the daemon had refused by then; the first user's requests are all refused.
TEST(HostileControl, ManyConnectionsOfOneUserAreServedLikeOne) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  constexpr std::uint64_t connections = 300, requests = 40;
  Attacker attacker([&](Attack& attack) {
    std::vector<std::unique_ptr<WireClient>> all;
    for (std::uint64_t i = 0; i < connections; ++i) {
      all.push_back(std::make_unique<WireClient>(stage.socket_path()));
      ASSERT_EQ(all.back()->hello().opcode(), Opcode::welcome);
    }
    attack.ready();
    while (attack.word(0) == 0) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    wire::WindowRequest nonsense{};
    nonsense.window = abi::window_count_max;
    for (std::uint64_t i = 0; i < requests; ++i) {
      for (const auto& client : all) client->send(Opcode::open_window, nonsense);
    }
    attack.word(1) = 1;
    for (const auto& client : all) {
      for (std::uint64_t i = 0; i < requests; ++i)
        EXPECT_EQ(client->next().opcode(), Opcode::refused)
            << "the daemon serves its own user's share";
    }
    attack.word(2) = 1;
    while (attack.goes_on()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  WireClient honest(stage.socket_path());
  ASSERT_EQ(honest.hello().opcode(), Opcode::welcome);
  const auto observer = observer_of(stage.socket_path());
  const std::uint64_t before = stage.counters().requests_refused;
  const pid_t daemon = stage.daemon().pid();
  ASSERT_EQ(::kill(daemon, SIGSTOP), 0);
  attacker.set_word(0, 1);
  EXPECT_TRUE(eventually([&] { return attacker.word(1) != 0; }));
  honest.send(Opcode::create_publisher, WireClient::endpoint("/honest", {}));
  observer->send(Opcode::dump, wire::Dump{});
  ASSERT_EQ(::kill(daemon, SIGCONT), 0);
  EXPECT_EQ(honest.next().opcode(), Opcode::endpoint_created);
  std::uint64_t refused = 0;
  for (Opcode opcode{}; opcode != Opcode::dump_end && !testing::Test::HasFailure();) {
    const Incoming packet = observer->next();
    opcode = packet.opcode();
    if (opcode == Opcode::dump_daemon)
      refused = packet.as<wire::DumpDaemon>().counters.requests_refused - before;
  }
  std::printf("%llu of %llu requests of the other user came first\n",
              static_cast<unsigned long long>(refused),
              static_cast<unsigned long long>(connections * requests));
  EXPECT_LT(refused, connections)
      << "the daemon served more than one request of each connection first";
  EXPECT_TRUE(eventually([&] { return attacker.word(2) != 0; }));
  EXPECT_EQ(stage.counters().requests_refused, before + connections * requests);
  stage.honest_goes_on();
  attacker.end();
}

TEST(HostileControl, AClientThatNeverReadsItsAnswersIsDisconnected) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside_many(
      stage,
      [&](Attack& attack) {
        PacketSocket socket;
        for (attack.ready(); attack.goes_on();) {
          if (!socket) {
            socket = connect_to(path);
            if (!socket) continue;
            wire::Hello hello{};
            hello.fingerprint = abi::fingerprint();
            say_to(socket, Opcode::hello, hello);
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
      },
      1, Ends::cut_off);
}

TEST(HostileControl, AProcessThatRejoinsTooOftenIsRefusedAndItsPublishersHearNothing) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  const auto begin = std::chrono::steady_clock::now();
  Attacker attacker([&](Attack& attack) {
    HostileNode node(path);
    node.join(Kind::subscription, stream_topic);
    // More addresses than count for others: the heap stays, and collides at each look.
    wire::Blocked range{};
    range.base = node.welcome().arena_base;
    range.bytes = node.welcome().arena_bytes;
    range.what = wire_name("hostile");
    node.wire().send(Opcode::blocked, range);
    node.wire().drain();
    attack.ready();
    while (attack.goes_on()) {
      node.wire().connect_again(path);
      const Incoming answer = node.wire().rejoin(node.welcome());
      const bool refused = answer.refused_code() == Errc::limit_reached;
      EXPECT_TRUE(refused || answer.opcode() == Opcode::rejoined) << answer.refused_text();
      ++attack.word(refused ? 1 : 0);
    }
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  const auto end = std::chrono::steady_clock::now() + attack_time();
  do {
    stage.honest_goes_on();
    stage.honest_is_served();
  } while (std::chrono::steady_clock::now() < end && !testing::Test::HasFailure());
  const auto seconds =
      std::chrono::duration_cast<std::chrono::seconds>(std::chrono::steady_clock::now() - begin)
          .count();
  attacker.end();
  std::printf("came back %llu times, was refused %llu times\n",
              static_cast<unsigned long long>(attacker.word(0)),
              static_cast<unsigned long long>(attacker.word(1)));
  EXPECT_GT(attacker.word(1), 0u);
  EXPECT_LE(attacker.word(0), 20u + 4u * (static_cast<std::uint64_t>(seconds) + 1));
  EXPECT_EQ(stage.publisher().ask("collisions"), "1");
}

TEST(HostileControl, SilentConnectionsTakeNobodysPlace) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside_many(stage, [&](Attack& attack) {
    std::vector<PacketSocket> silent;
    attack.ready();
    while (attack.goes_on()) {
      PacketSocket socket = connect_to(path);
      if (socket) silent.push_back(std::move(socket));
      if (silent.size() > 900) silent.clear();
    }
  });
}

TEST(HostileControl, FloodsOfConnectionsDelayNoOtherUser) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside_many(
      stage,
      [&](Attack& attack) {
        attack.ready();
        while (attack.goes_on()) {
          const PacketSocket socket = connect_to(path);
          if (!socket) continue;
          wire::Hello hello{};
          hello.fingerprint = abi::fingerprint();
          say_to(socket, Opcode::hello, hello);
          ++attack.word(0);
        }
      },
      3);
}

/// A window of the usual length in the last place of the arena, which nobody uses.
wire::WindowOpened place_in_arena(HostileNode& node) {
  wire::WindowOpened window{};
  window.bytes = std::uint64_t{64} << 20;
  window.base = node.welcome().arena_base + node.welcome().arena_bytes - window.bytes;
  return window;
}

/// Returns the daemon's answer.
Errc bring(HostileNode& node, const wire::WindowOpened& window, std::span<const int> fds) {
  wire::BringWindow request{};
  request.header = {Opcode::bring_window, sizeof request, 98};
  request.window = window.window;
  request.base = window.base;
  request.bytes = window.bytes;
  request.first = window.first;
  const auto sent =
      node.wire().socket().send(std::as_bytes(std::span(&request, 1)), fds, Wait::yes);
  // The kernel itself passes no io_uring: then the daemon has received no request.
  if (!sent || *sent != Sent::sent)
    return fds.size() > 1 ? Errc::protocol_violation : Errc::permission_denied;
  for (;;) {
    const Incoming answer = node.wire().next();
    if (answer.bytes.empty()) return Errc::ok;  // the test has failed
    if (answer.header().request == 98) return answer.refused_code();
  }
}

TEST(HostileControl, DescriptorsOfUnexpectedKindsAreClosedUnused) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside_many(stage, [&](Attack& attack) {
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
          HostileNode other(path);
          wire::WindowRequest request{};
          request.header = {Opcode::open_window, sizeof request, 99};
          // The kernel passes no io_uring, and no sockets nested too deeply.
          const auto sent = other.wire().socket().send(std::as_bytes(std::span(&request, 1)),
                                                       std::span(fds).first(count));
          if (!sent || *sent != Sent::sent) continue;
          EXPECT_EQ(other.wire().next().refused_code(), Errc::protocol_violation);
          EXPECT_TRUE(other.wire().is_hung_up())
              << "the descriptors go together with the connection";
        }
        // Where a descriptor is allowed the daemon checks it: none is a window.
        const auto window = place_in_arena(node);
        EXPECT_EQ(bring(node, window, std::span(fds).first(1)), Errc::permission_denied);
        EXPECT_EQ(bring(node, window, std::span(fds).first(4)), Errc::protocol_violation);
      }
      strange.pop_back();
      EXPECT_EQ(node.wire().open_window(0).opcode(), Opcode::window_opened)
          << "the attacker's session continues";
      ++attack.word(0);
    }
  });
}

// Brings every descriptor that it received, of other processes and its own, for the right place
// and for others' places. It could only bring windows that a daemon made for its user there, and
// those are in use.
TEST(HostileControl, MissingWindowsAndThoseOfOthersCannotBeBrought) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside_many(stage, [&](Attack& attack) {
    HostileNode owner(path);
    owner.join(Kind::subscription, stream_topic);
    const auto honest = owner.announced();
    ASSERT_EQ(honest.fds.size(), 2u) << "region and window of the honest publisher";
    ASSERT_EQ(honest.body.window_count, 1u);
    const wire::WindowOpened own = owner.open_window();
    wire::WindowOpened others = own;
    others.base = honest.body.window[0].base;
    attack.ready();
    while (attack.goes_on()) {
      HostileNode node(path);
      for (const wire::WindowOpened& place : {place_in_arena(node), others, own}) {
        EXPECT_EQ(bring(node, place, {}), Errc::protocol_violation);
        for (const int fd : {honest.fds[0].get(), honest.fds[1].get(), owner.region_fd(),
                             owner.board_fd(), owner.window_read_fd(), node.region_fd()})
          EXPECT_EQ(bring(node, place, std::span(&fd, 1)), Errc::permission_denied);
        const int writer = owner.window_fd();
        EXPECT_EQ(bring(node, place, std::span(&writer, 1)),
                  place.base == own.base ? Errc::arena_occupied : Errc::permission_denied);
      }
      EXPECT_EQ(node.wire().open_window(0).opcode(), Opcode::window_opened)
          << "the attacker's session continues";
      ++attack.word(0);
    }
  });
}

TEST(HostileControl, RequestsBeforeHelloAndASecondHelloAreRefused) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  Attacker attacker([&](Attack&) {
    WireClient client(stage.socket_path());
    EXPECT_EQ(client.open_window(0).refused_code(), Errc::protocol_violation);
    EXPECT_EQ(client.open_wait_set().refused_code(), Errc::protocol_violation);
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

// Observers can see every number of every process; this one claims them all.
TEST(HostileControl, ClaimsAboutOthersEndpointsChangeNothing) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside_many(stage, [&](Attack& attack) {
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
        // It may acknowledge what it was sent, and loses it; the rest has no effect.
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
            << "the place belongs to another process";
        wire::Revoke revoke{};
        revoke.client = process.client;
        revoke.generation = process.generation;
        EXPECT_EQ(observer.ask(Opcode::revoke, revoke).refused_code(), Errc::permission_denied)
            << "the process belongs to another user";
        revoke.generation += 1;
        EXPECT_EQ(observer.ask(Opcode::revoke, revoke).refused_code(), Errc::endpoint_gone);
      }
      node.wire().drain();
    }
  });
}

/// Returns a connection that the daemon treats as an observer's, or none.
PacketSocket observe(const std::string& path) {
  PacketSocket socket = connect_to(path);
  wire::Observe request{};
  request.fingerprint = abi::fingerprint();
  if (!socket || !say_to(socket, Opcode::observe, request)) return {};
  std::array<std::byte, 2048> buffer;
  pollfd answer{socket.fd(), POLLIN, 0};
  if (::poll(&answer, 1, WireClient::patience_ms) != 1) return {};
  const auto packet = socket.receive(buffer);
  wire::Header header{};
  if (!packet || packet->bytes < sizeof header) return {};
  std::memcpy(static_cast<void*>(&header), buffer.data(), sizeof header);
  if (header.opcode != Opcode::observed) socket.close();
  return socket;
}

TEST(HostileControl, ObserversThatAskWithoutEndAreDisconnected) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  honest_goes_on_beside_many(
      stage,
      [&](Attack& attack) {
        std::vector<PacketSocket> observers;
        attack.ready();
        while (attack.goes_on()) {
          while (observers.size() < abi::observer_count_max) {
            PacketSocket socket = observe(path);
            if (!socket) break;
            observers.push_back(std::move(socket));
          }
          wire::Dump request{};
          request.header = {Opcode::dump, sizeof request, 1};
          for (auto at = observers.begin(); at != observers.end();) {
            const auto sent = at->send(std::as_bytes(std::span(&request, 1)));
            if (sent && *sent != Sent::peer_gone) {
              // answered, or the request was not sent: the daemon has not read the earlier ones
              ++at;
            } else {
              at = observers.erase(at);
              ++attack.word(0);
            }
          }
        }
      },
      1, Ends::cut_off);
}

}  // namespace
}  // namespace agnocast::test
