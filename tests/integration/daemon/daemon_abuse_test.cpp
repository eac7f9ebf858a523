// SPDX-License-Identifier: Apache-2.0
//
// Goal: nothing that one client sends, or does not read, disturbs another, and the daemon keeps
// its memory and descriptors. Method: as daemon_protocol_test.cpp, beside a pair that goes on.

#include <agnocast/abi/client_region.hpp>
#include <tests/integration/daemon/raw_node.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/rotation.hpp>
#include <tests/support/wire/wire_client.hpp>
#include <tests/support/wire/wire_dump.hpp>

#include <fcntl.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <random>
#include <vector>

namespace agnocast::test {
namespace {

using abi::Qos;
using wire::Kind;
using wire::Opcode;
using Node = RawNode;

// An honest pair that keeps doing things, for tests that misbehave beside it.
class HonestPair {
 public:
  explicit HonestPair(const DaemonProcess& daemon) : publisher_(daemon), subscriber_(daemon) {
    p_ = publisher_.publisher("/honest");
    publisher_.wire.drain();
  }
  void round() {
    const auto s = subscriber_.subscription("/honest");
    const auto about_p = subscriber_.wire.expect<wire::Announcement>(Opcode::announce);
    EXPECT_EQ(about_p.index, p_.index);
    const auto about_s = publisher_.wire.expect<wire::Announcement>(Opcode::announce);
    EXPECT_EQ(about_s.generation, s.generation);
    for (const Opcode opcode : {Opcode::leave, Opcode::drained}) {
      EXPECT_EQ(
          subscriber_.wire.reference(opcode, Kind::subscription, s.topic, s.index, s.generation)
              .opcode(),
          Opcode::done);
    }
    EXPECT_EQ(publisher_.wire.expect<wire::Reference>(Opcode::kick).index, p_.index);
    EXPECT_EQ(publisher_.wire.expect<wire::Reference>(Opcode::forget).index, s.index);
    publisher_.wire.unlinked(Kind::subscription, s.topic, s.index, s.generation);
    EXPECT_TRUE(publisher_.wire.drain().empty());
    EXPECT_EQ(s.index, 0u) << "its place is used again every time";
  }

 private:
  Node publisher_, subscriber_;
  wire::EndpointCreated p_{};
};

TEST(DaemonProtocol, SurvivesGarbageWhileAnHonestPairGoesOn) {
  DaemonProcess daemon;
  HonestPair honest(daemon);
  std::mt19937_64 random(4711);
  const Opcode opcodes[] = {Opcode::hello,
                            Opcode::open_window,
                            Opcode::open_wait_set,
                            Opcode::create_publisher,
                            Opcode::create_subscription,
                            Opcode::leave,
                            Opcode::drained,
                            Opcode::unlinked};
  // Connections that never speak stay open all the time.
  std::vector<WireClient> silent;
  for (int i = 0; i < 20; ++i) silent.emplace_back(daemon.socket_path());
  { Node accepted_after_them(daemon); }
  honest.round();
  const std::size_t fds_before = daemon.descriptor_count();
  for (int round = 0; round < 60; ++round) {
    WireClient garbage(daemon.socket_path());
    if (round % 2 == 0) garbage.hello();
    const UniqueFd null(::open("/dev/null", O_RDONLY | O_CLOEXEC));
    for (int i = 0; i < 40; ++i) {
      std::vector<std::byte> packet(1 + random() % 2000);
      for (std::byte& byte : packet)
        byte = static_cast<std::byte>(random() % 3 == 0 ? random() : 0);
      if (random() % 8 != 0 && packet.size() >= sizeof(wire::Header)) {
        const std::size_t sizes[] = {sizeof(wire::Hello), sizeof(wire::Reference),
                                     sizeof(wire::Unlinked), sizeof(wire::CreateEndpoint),
                                     sizeof(wire::WindowRequest)};
        packet.resize(sizes[random() % std::size(sizes)]);
        const wire::Header header{opcodes[random() % std::size(opcodes)],
                                  static_cast<std::uint32_t>(packet.size()), random()};
        std::memcpy(packet.data(), &header, sizeof header);
      }
      const int fds[] = {null.get(), null.get()};
      // Since Linux 6.16 the kernel refuses them, and the packet with them.
      if (!garbage.send_bytes(packet, std::span(fds).first(random() % 8 == 0 ? 2 : 0))) break;
    }
    honest.round();
    if (testing::Test::HasFailure()) break;
  }
  // Fewer: a connection that had ended before may still have been closing.
  ASSERT_TRUE(eventually([&] { return daemon.descriptor_count() <= fds_before; }))
      << daemon.descriptor_count() << " instead of " << fds_before;
  EXPECT_TRUE(daemon.is_running());
  honest.round();
}

TEST(DaemonProtocol, UsesNoMemoryForPlacesThatARequestOnlyNames) {
  DaemonProcess daemon;
  Node node(daemon);
  node.publisher("/topic");
  const std::size_t before = daemon.shared_bytes();
  for (std::uint32_t topic = 0; topic < abi::topic_count_max; ++topic) {
    node.wire.unlinked(Kind::publisher, topic, topic % abi::publisher_count_max, 1);
    node.wire.unlinked(Kind::subscription, topic, topic % abi::subscription_count_max, 1);
    node.wire.unlinked(Kind::region, 0, topic % abi::client_count_max, 1);
    if (topic % 64 == 0) {
      EXPECT_EQ(
          node.wire.reference(Opcode::leave, Kind::subscription, topic, 700, 1).refused_code(),
          Errc::protocol_violation);
    }
  }
  for (std::uint32_t index = 0; index < abi::subscription_count_max; ++index)
    node.wire.unlinked(Kind::subscription, 0, index, 1);
  node.wire.drain();
  EXPECT_LT(daemon.shared_bytes(), before + (256 << 10));
}

// Well-formed requests in any order, about the client's own endpoints and others': whatever a
// client claims to have left, drained or unlinked, the daemon's own invariants hold (it aborts
// when one does not), and when all are gone nothing is left. AGNOCAST_ROTATION: a part of the
// seeds, one at least. Long because each request has its branch.
TEST(DaemonProtocol, SurvivesAnyOrderOfPlausibleRequests) {
  const Rotation rotation;
  constexpr std::uint64_t seeds = 6;
  for (std::uint64_t seed = 1; seed <= seeds; ++seed) {
    if (!rotation.takes(seed - 1, seeds)) continue;
    SCOPED_TRACE("seed " + std::to_string(seed));
    DaemonProcess daemon;
    std::mt19937_64 random(seed);
    struct Endpoint {
      Kind kind;
      std::uint32_t topic;
      std::uint64_t index, generation;
    };
    struct Process {
      std::unique_ptr<WireClient> wire;
      wire::Welcome welcome{};
    };
    std::vector<Process> processes(6);
    std::vector<Endpoint> endpoints;
    unsigned accepted = 0, lives = 0, made = 0, full = 0;
    const std::size_t fds = [&] {
      // creates the one-time objects now; its own: socket, pidfd, region twice
      Node first(daemon);
      return daemon.descriptor_count() - 4;
    }();
    for (int step = 0; step < 6000 && !HasFailure(); ++step) {
      Process& process = processes[random() % processes.size()];
      if (!process.wire || random() % 100 == 0) {
        process.wire = std::make_unique<WireClient>(daemon.socket_path());
        const Incoming answer = process.wire->hello();
        ASSERT_EQ(answer.opcode(), Opcode::welcome) << answer.refused_text();
        process.welcome = answer.as<wire::Welcome>();
        process.wire->open_wait_set();
        ++lives;
      }
      WireClient& client = *process.wire;
      const std::string topic = "/topic" + std::to_string(random() % 3);
      const Qos qos{static_cast<std::uint32_t>(1 + random() % 500), random() % 2 == 0,
                    random() % 2 == 0, random() % 4 == 0, false};
      const Endpoint any = endpoints.empty() ? Endpoint{Kind::publisher, 0, 0, 1}
                                             : endpoints[random() % endpoints.size()];
      const std::uint64_t seen = client.seen() - std::min(client.seen(), random() % 4);
      switch (random() % 9) {
        case 0:
        case 1: {
          const bool publisher = random() % 2 == 0;
          const Incoming created = publisher ? client.create_publisher(topic, qos)
                                             : client.create_subscription(topic, qos);
          // Others have not unmapped yet what is gone: how much that is depends on who runs when.
          if (publisher && created.opcode() == Opcode::refused &&
              created.refused_code() == Errc::quota_exceeded) {
            ++full;
            break;
          }
          ++made;
          ASSERT_EQ(created.opcode(), Opcode::endpoint_created) << created.refused_text();
          const auto body = created.as<wire::EndpointCreated>();
          endpoints.push_back({publisher ? Kind::publisher : Kind::subscription, body.topic,
                               body.index, body.generation});
          if (endpoints.size() > 60) endpoints.erase(endpoints.begin());
          break;
        }
        case 2:
        case 3:
        case 4: {
          const Opcode opcode = random() % 2 == 0 ? Opcode::leave : Opcode::drained;
          const Incoming answer =
              client.reference(opcode, any.kind, any.topic, any.index, any.generation);
          if (answer.opcode() == Opcode::done) ++accepted;
          break;
        }
        case 5:
        case 6:
          client.unlinked(any.kind, any.topic, any.index, any.generation, seen);
          break;
        case 7: {
          const Process& other = processes[random() % processes.size()];
          client.unlinked(Kind::region, 0, other.welcome.client,
                          std::max<std::uint64_t>(other.welcome.client_generation, 1), seen);
          break;
        }
        default:
          client.open_window(random() % 3);
          break;
      }
      client.drain();
    }
    EXPECT_GT(accepted, 100u);
    EXPECT_GT(made, 2 * full);
    EXPECT_GT(lives, 30u);
    processes.clear();
    ASSERT_TRUE(eventually([&] { return daemon.descriptor_count() <= fds; }))
        << daemon.descriptor_count() << " descriptors, " << fds << " descriptors at the beginning";
    Node last(daemon);
    EXPECT_EQ(last.welcome.client, 0u);
    const auto p = last.publisher("/again");
    EXPECT_EQ(p.topic, 0u);
    EXPECT_EQ(p.index, 0u);
    EXPECT_EQ(p.extent, abi::page_bytes);
    EXPECT_EQ(last.wire.open_window(0).as<wire::WindowOpened>().base, last.welcome.arena_base);
    EXPECT_TRUE(daemon.is_running());
  }
}

TEST(DaemonProtocol, EndsAConnectionThatCannotBeParsedAndAnswersTheRest) {
  DaemonProcess daemon;
  HonestPair honest(daemon);
  WireClient short_one(daemon.socket_path());
  const std::byte bytes[3] = {};
  ASSERT_TRUE(short_one.send_bytes(bytes));
  EXPECT_TRUE(short_one.is_hung_up());
  WireClient long_one(daemon.socket_path());
  ASSERT_TRUE(long_one.send_bytes(std::vector<std::byte>(wire::packet_bytes_max + 1)));
  EXPECT_TRUE(long_one.is_hung_up());
  Node node(daemon);
  EXPECT_EQ(node.wire.open_window(abi::window_count_max).opcode(), Opcode::refused);
  EXPECT_EQ(node.wire.open_window(0).opcode(), Opcode::window_opened) << "the session continues";
  honest.round();
}

// The daemon never receives descriptors that a request carries: the kernel refuses the send, or,
// before Linux 6.16, the daemon ends the connection with everything queued on it.
TEST(DaemonProtocol, EndsAConnectionThatBringsDescriptors) {
  for (const bool before_passrights : {false, true}) {
    SCOPED_TRACE(before_passrights);
    DaemonProcess daemon({.without_passrights = before_passrights});
    HonestPair honest(daemon);
    Node node(daemon);
    node.wire.open_window(0);  // after a request no window may be brought any more
    const int fd = node.fds[0].get();
    const auto say = [&](Opcode opcode, auto body) {
      body.header = {opcode, sizeof body, 99};
      const auto sent = node.wire.socket().send(std::as_bytes(std::span(&body, 1)), {&fd, 1});
      return !sent ? sent.error().os_errno : 0;
    };
    const int error = say(Opcode::open_window, wire::WindowRequest{});
    if (error == EPERM) {
      EXPECT_FALSE(before_passrights);
      EXPECT_EQ(say(Opcode::bring_window, wire::BringWindow{}), EPERM);
      EXPECT_EQ(node.wire.open_window(1).opcode(), Opcode::window_opened)
          << "the session continues";
    } else {
      const auto refused = node.wire.next();
      EXPECT_EQ(refused.header().request, 99u);
      EXPECT_EQ(refused.refused_text(), "descriptors came with a request");
      EXPECT_TRUE(node.wire.is_hung_up());
    }
    honest.round();
  }
}

TEST(DaemonProtocol, KeepsThePacketsOfASlowClientInOrder) {
  DaemonProcess daemon;
  HonestPair honest(daemon);
  WireClient slow(daemon.socket_path());
  slow.hello();
  // Far more answers than a socket holds, far fewer than the queue does.
  constexpr std::uint64_t count = 5000;
  wire::WindowRequest nonsense{};
  nonsense.window = abi::window_count_max;
  for (std::uint64_t request = 1; request <= count; ++request) {
    nonsense.header = {Opcode::open_window, sizeof nonsense, 1000 + request};
    ASSERT_TRUE(slow.send_bytes(std::as_bytes(std::span(&nonsense, 1))));
  }
  honest.round();
  for (std::uint64_t request = 1; request <= count; ++request)
    ASSERT_EQ(slow.next().header().request, 1000 + request);
  EXPECT_EQ(slow.create_publisher("/topic").opcode(), Opcode::endpoint_created);
  honest.round();
}

TEST(DaemonProtocol, AnswersThatNobodyReadsCostNoDescriptorEach) {
  DaemonProcess daemon;
  WireClient deaf(daemon.socket_path());
  deaf.hello();
  ASSERT_EQ(deaf.open_window(0).opcode(), Opcode::window_opened);
  ASSERT_EQ(deaf.open_wait_set().opcode(), Opcode::wait_set_opened);
  const std::size_t before = daemon.descriptor_count();
  constexpr std::uint64_t count = 1'000;
  for (std::uint64_t i = 0; i < count; ++i) {
    deaf.send(Opcode::open_window, wire::WindowRequest{});
    wire::WaitSetRequest wait_set{};
    wait_set.header = {Opcode::open_wait_set, sizeof wait_set, (i + 1) | wire::asked_again};
    ASSERT_TRUE(deaf.send_bytes(std::as_bytes(std::span(&wait_set, 1))));
  }
  ASSERT_TRUE(eventually([&] {
    return wire_dump(daemon.socket_path()).daemon.counters.requests_answered_again == 2 * count;
  }));
  EXPECT_LE(daemon.descriptor_count(), before + 16);
}

// The daemon makes doorbells when it sends a packet. Until then its subscription may be gone and
// its place another's.
TEST(DaemonProtocol, AnAnnouncementThatIsReadLateHasNoDoorbellsOfAnotherSubscription) {
  DaemonProcess daemon;
  WireClient late(daemon.socket_path()), first(daemon.socket_path()), next(daemon.socket_path());
  const Incoming welcome = late.hello();
  const auto publisher = late.create_publisher("/topic").as<wire::EndpointCreated>();
  constexpr std::uint64_t count = 5000;  // more answers than a socket holds
  wire::WindowRequest nonsense{};
  nonsense.window = abi::window_count_max;
  for (std::uint64_t i = 0; i < count; ++i) late.send(Opcode::open_window, nonsense);
  ASSERT_TRUE(eventually(
      [&] { return wire_dump(daemon.socket_path()).daemon.counters.requests_refused == count; }));
  std::vector<Incoming> doorbells;  // keeps their ends open: closed ones cannot be connected to
  const auto subscribe = [&](WireClient& client) {
    client.hello();
    doorbells.push_back(client.open_wait_set());
    return client.create_subscription("/topic").as<wire::EndpointCreated>();
  };
  const auto is_left = [&](std::size_t endpoints) {
    return eventually(
        [&] { return wire_dump(daemon.socket_path()).endpoints.size() == endpoints; });
  };
  const auto gone = subscribe(first);
  wire::Reference reference{};
  reference.kind = Kind::publisher;
  reference.topic = publisher.topic;
  reference.index = publisher.index;
  reference.generation = publisher.generation;
  late.send(Opcode::leave, reference);
  first.expect<wire::Announcement>(Opcode::announce);
  first.expect<wire::Orphaned>(Opcode::orphaned);
  for (const Opcode opcode : {Opcode::leave, Opcode::drained})
    ASSERT_EQ(first.reference(opcode, Kind::subscription, gone.topic, gone.index, gone.generation)
                  .opcode(),
              Opcode::done);
  late.send(Opcode::drained, reference);
  ASSERT_TRUE(is_left(0));
  const auto there = subscribe(next);
  ASSERT_EQ(there.topic, gone.topic) << "the place was not reused, so the test proves nothing";
  ASSERT_EQ(there.index, gone.index) << "the place was not reused, so the test proves nothing";

  Incoming packet = late.next();
  while (packet.opcode() == Opcode::refused) packet = late.next();
  ASSERT_EQ(packet.opcode(), Opcode::announce);
  const auto announcement = packet.as<wire::Announcement>();
  EXPECT_EQ(announcement.generation, gone.generation);
  EXPECT_EQ(announcement.doorbell_count, 0u);
  EXPECT_EQ(packet.fds.size(), 1u) << "only the region";
}

TEST(DaemonProtocol, DisconnectsAClientThatDoesNotRead) {
  DaemonProcess daemon({.config = "[quota]\nheld_messages = \"unlimited\"\n"});
  HonestPair honest(daemon);
  WireClient deaf(daemon.socket_path());
  deaf.hello();
  // The daemon answers every request; nobody reads the answers.
  wire::WindowRequest nonsense{};
  nonsense.window = abi::window_count_max;
  nonsense.header = {Opcode::open_window, sizeof nonsense, 1};
  bool ended = false;
  for (int i = 0; i < 100000 && !ended; ++i) {
    const auto sent = deaf.socket().send(std::as_bytes(std::span(&nonsense, 1)), {}, Wait::yes);
    ended = !sent || *sent == Sent::peer_gone;
    if (i % 4096 == 0) honest.round();
  }
  EXPECT_TRUE(ended);
  EXPECT_TRUE(daemon.wait_for_log("the process does not read"));
  honest.round();
}

}  // namespace
}  // namespace agnocast::test
