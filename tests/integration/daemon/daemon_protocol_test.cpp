// SPDX-License-Identifier: Apache-2.0
//
// Goal: the daemon answers every request as docs/control-plane.md says, announcements come in its
// order with descriptors that work and grant no more than they should.
// Method: raw clients against the real daemon. "Nothing more came" is asked, not waited for: the
// answer to a harmless request comes after all earlier packets.

#include <agnocast/abi/board.hpp>
#include <agnocast/abi/client_region.hpp>
#include <base/descriptors/doorbell.hpp>
#include <base/memory/mapping.hpp>
#include <base/memory/memory_policy.hpp>
#include <region/views.hpp>
#include <tests/integration/daemon/raw_node.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/wire/wire_client.hpp>

#include <gtest/gtest.h>
#include <sys/epoll.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>

namespace agnocast::test {
namespace {

using abi::Qos;
using wire::Kind;
using wire::Opcode;
using Node = RawNode;

TEST(DaemonProtocol, WelcomesWithBoardRegionAndArena) {
  DaemonProcess daemon;
  Node node(daemon);
  EXPECT_EQ(node.welcome.fingerprint, abi::fingerprint());
#if !defined(AGNOCAST_UNDER_THREAD_SANITIZER)  // there the test's daemon has another base
  EXPECT_EQ(node.welcome.arena_base, 0x200000000000u);
#endif
  EXPECT_EQ(node.welcome.arena_bytes, std::uint64_t{64} << 30);
  EXPECT_NE(node.welcome.incarnation, 0u);
  EXPECT_EQ(word(node.board, offsetof(abi::BoardHeader, magic)), abi::board_magic);
  EXPECT_EQ(word(node.board, offsetof(abi::BoardHeader, incarnation)), node.welcome.incarnation);
  EXPECT_EQ(word(node.region, offsetof(abi::ClientRegionHeader, magic)), abi::client_region_magic);
  EXPECT_EQ(word(node.region, offsetof(abi::ClientRegionHeader, generation)),
            node.welcome.client_generation);
  Node second(daemon);
  EXPECT_NE(second.welcome.client, node.welcome.client);
  EXPECT_GT(second.welcome.client_generation, node.welcome.client_generation);
}

TEST(DaemonProtocol, RefusesAnotherLayoutAndNamesBoth) {
  DaemonProcess daemon;
  WireClient client(daemon.socket_path());
  const Incoming answer = client.hello(0xabcdef);
  EXPECT_EQ(answer.refused_code(), Errc::layout_mismatch);
  EXPECT_NE(answer.refused_text().find("0x0000000000abcdef"), std::string::npos);
  char own[32];
  std::snprintf(own, sizeof own, "0x%016llx", static_cast<unsigned long long>(abi::fingerprint()));
  EXPECT_NE(answer.refused_text().find(own), std::string::npos) << answer.refused_text();
  EXPECT_EQ(client.open_window(0).refused_code(), Errc::protocol_violation)
      << "no other request works without hello";
  EXPECT_TRUE(daemon.wait_for_log("code=layout_mismatch"));
}

// A child says hello on its parent's connection: whose process is it?
void say_hello_in_a_child(WireClient& client) {
  const pid_t pid = ::fork();
  if (pid == 0) {
    wire::Hello hello{};
    hello.header = {Opcode::hello, sizeof hello, 1};
    hello.fingerprint = abi::fingerprint();
    ::_exit(client.send_bytes(std::as_bytes(std::span(&hello, 1))) ? 0 : 1);
  }
  int status = 0;
  ::waitpid(pid, &status, 0);
  EXPECT_EQ(status, 0);
}

TEST(DaemonProtocol, KnowsTheProcessThatConnectedOnEveryKernel) {
  {
    DaemonProcess daemon;
    WireClient client(daemon.socket_path());
    say_hello_in_a_child(client);
    EXPECT_EQ(client.next().opcode(), Opcode::welcome)
        << "the daemon knows the process that connected";
  }
  DaemonProcess daemon({.without_peer_pidfd = true});
  WireClient client(daemon.socket_path());
  say_hello_in_a_child(client);
  const Incoming refused = client.next();
  EXPECT_EQ(refused.refused_code(), Errc::permission_denied);
  EXPECT_EQ(refused.refused_text(), "the process that connected is not the one that says hello");
  EXPECT_EQ(client.hello().opcode(), Opcode::welcome) << "it may say hello itself";
  EXPECT_EQ(client.create_publisher("/topic").opcode(), Opcode::endpoint_created);
}

// Long because both announcements are compared field by field.
TEST(DaemonProtocol, AnnouncesBothSidesInOrderWithWorkingDescriptors) {
  DaemonProcess daemon;
  Node subscriber(daemon), publisher(daemon);
  const auto s = subscriber.subscription("/topic");
  ASSERT_EQ(publisher.wire.open_window(0).opcode(), Opcode::window_opened);
  const auto p = publisher.publisher("/topic");
  EXPECT_EQ(p.topic, s.topic);
  EXPECT_EQ(word(publisher.region, p.extent), abi::pack_entry(p.first_sequence, 0))
      << "the daemon writes the initial head";
  EXPECT_EQ(abi::state_of(publisher_word(subscriber.board, p.topic, p.index)),
            abi::BoardState::active);

  std::vector<UniqueFd> fds;
  const auto about_p = subscriber.wire.expect<wire::Announcement>(Opcode::announce, &fds);
  EXPECT_EQ(about_p.kind, Kind::publisher);
  EXPECT_EQ(about_p.index, p.index);
  EXPECT_EQ(about_p.generation, p.generation);
  EXPECT_EQ(about_p.own_index, s.index);
  EXPECT_EQ(about_p.own_generation, s.generation);
  EXPECT_EQ(about_p.client, publisher.welcome.client);
  EXPECT_EQ(about_p.client_generation, publisher.welcome.client_generation);
  EXPECT_EQ(about_p.first_sequence, p.first_sequence);
  EXPECT_EQ(about_p.from_start, 1u);
  EXPECT_EQ(about_p.window_count, 1u);
  EXPECT_EQ(about_p.window[0].bytes, std::uint64_t{64} << 20);
  ASSERT_EQ(fds.size(), 2u);
  const Mapping peer = map_region(fds[0], Mapping::Access::read);
  EXPECT_EQ(word(peer, about_p.extent), abi::pack_entry(p.first_sequence, 0));

  const auto about_s = publisher.wire.expect<wire::Announcement>(Opcode::announce, &fds);
  EXPECT_EQ(about_s.kind, Kind::subscription);
  EXPECT_EQ(about_s.index, s.index);
  EXPECT_EQ(about_s.generation, s.generation);
  EXPECT_EQ(about_s.own_index, p.index);
  EXPECT_EQ(about_s.doorbell_count, 2u) << "one user: eventfd and datagram";
  ASSERT_EQ(fds.size(), 3u);

  const UniqueFd epoll(::epoll_create1(EPOLL_CLOEXEC));
  ASSERT_TRUE(subscriber.doorbells.add_to(epoll.get(), 1, 2));
  const Doorbell doorbell(std::move(fds[2]), std::move(fds[1]));
  EXPECT_EQ(doorbell.ring(), Doorbell::Rung::rung);
  epoll_event event{};
  ASSERT_EQ(::epoll_wait(epoll.get(), &event, 1, 1000), 1);
  EXPECT_EQ(std::uint64_t{event.data.u64}, 1u);

  // A second publisher, in the subscriber's own process: announced like any other.
  const auto own = subscriber.publisher("/topic");
  const auto first = subscriber.wire.expect<wire::Announcement>(Opcode::announce);
  EXPECT_EQ(first.kind, Kind::publisher);
  EXPECT_EQ(first.index, own.index);
  EXPECT_EQ(first.client, subscriber.welcome.client);
  const auto second = subscriber.wire.expect<wire::Announcement>(Opcode::announce);
  EXPECT_EQ(second.kind, Kind::subscription);
  EXPECT_EQ(second.index, s.index);
  EXPECT_TRUE(publisher.wire.drain().empty());

  // A late subscription first gets all publishers, from their current head.
  region::PublisherWords<SharedMemory>{publisher.region.base(), p.extent}.head().store(
      abi::pack_entry(p.first_sequence + 5, 3));
  const auto late = subscriber.subscription("/topic");
  const auto start = [&](std::uint64_t index) {
    return region::LinkWords<SharedMemory>{subscriber.region.base(), late.extent, index}
        .cursor()
        .load();
  };
  EXPECT_EQ(start(p.index), p.first_sequence + 6);
  EXPECT_EQ(start(own.index), own.first_sequence + 1);
  for (const std::uint64_t index : {p.index, own.index}) {
    const auto about = subscriber.wire.expect<wire::Announcement>(Opcode::announce);
    EXPECT_EQ(about.kind, Kind::publisher);
    EXPECT_EQ(about.index, index);
    EXPECT_EQ(about.own_index, late.index);
    EXPECT_EQ(about.from_start, 0u);
  }
  EXPECT_EQ(subscriber.wire.expect<wire::Announcement>(Opcode::announce).kind, Kind::subscription);
  EXPECT_EQ(publisher.wire.expect<wire::Announcement>(Opcode::announce).index, late.index);
}

TEST(DaemonProtocol, AnnouncesAWindowBeforeItAnswersItsOwner) {
  DaemonProcess daemon;
  Node subscriber(daemon), publisher(daemon), stranger(daemon);
  subscriber.subscription("/topic");
  publisher.publisher("/topic");
  subscriber.wire.expect<wire::Announcement>(Opcode::announce);
  Incoming opened = publisher.wire.open_window(0);
  ASSERT_EQ(opened.opcode(), Opcode::window_opened);
  // The answer is here, so the announcement is in the subscriber's socket: no waiting.
  auto packet = subscriber.wire.poll();
  ASSERT_TRUE(packet);
  ASSERT_EQ(packet->opcode(), Opcode::window_announced);
  const auto announced = packet->as<wire::WindowAnnounced>();
  const auto window = opened.as<wire::WindowOpened>();
  EXPECT_EQ(announced.client, publisher.welcome.client);
  EXPECT_EQ(announced.base, window.base);
  EXPECT_EQ(announced.bytes, window.bytes);
  ASSERT_EQ(packet->fds.size(), 1u);
  EXPECT_TRUE(stranger.wire.drain().empty());

  // The same memory behind both descriptors; a repeated request returns the same window.
  ASSERT_EQ(opened.fds.size(), 2u);
  const char written = 'x';
  ASSERT_EQ(::pwrite(opened.fds[0].get(), &written, 1, 12345), 1);
  char read = 0;
  ASSERT_EQ(::pread(packet->fds[0].get(), &read, 1, 12345), 1);
  EXPECT_EQ(read, 'x');
  Incoming again = publisher.wire.open_window(0);
  ASSERT_EQ(again.opcode(), Opcode::window_opened);
  EXPECT_EQ(again.as<wire::WindowOpened>().base, window.base);
  ASSERT_EQ(again.fds.size(), 2u);
  EXPECT_EQ(::pwrite(again.fds[0].get(), &written, 1, 0), 1);
  EXPECT_EQ(publisher.wire.open_window(2).refused_code(), Errc::protocol_violation);
  EXPECT_EQ(stranger.wire.open_window(0).as<wire::WindowOpened>().base, window.base + window.bytes);
}

TEST(DaemonProtocol, GivesAnotherUserOnlyTheDatagramDoorbell) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and another user";
  DaemonProcess daemon;
  Node subscriber(daemon);
  subscriber.subscription("/topic");
  const UniqueFd epoll(::epoll_create1(EPOLL_CLOEXEC));
  ASSERT_TRUE(subscriber.doorbells.add_to(epoll.get(), 1, 2));
  EXPECT_EQ(in_other_user([&] {
              Node publisher(daemon);
              publisher.publisher("/topic");
              std::vector<UniqueFd> fds;
              const auto about = publisher.wire.expect<wire::Announcement>(Opcode::announce, &fds);
              if (about.doorbell_count != 1 || fds.size() != 2) return 1;
              return Doorbell(std::move(fds[1])).ring() == Doorbell::Rung::rung ? 0 : 2;
            }),
            0);
  epoll_event event{};
  ASSERT_EQ(::epoll_wait(epoll.get(), &event, 1, 1000), 1);
  EXPECT_EQ(std::uint64_t{event.data.u64}, 2u);
}

TEST(DaemonProtocol, RingsSubscriptionsWhoseDoorbellFilesWereRemoved) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and another user";
  DaemonProcess daemon;
  const std::string doorbells = daemon.socket_path() + ".bells";
  Node subscriber(daemon);
  subscriber.subscription("/topic");
  const UniqueFd epoll(::epoll_create1(EPOLL_CLOEXEC));
  ASSERT_TRUE(subscriber.doorbells.add_to(epoll.get(), 1, 2));
  // When a publisher has ended, the daemon rings as well, but only by datagram.
  const auto is_rung_by = [&](std::uint64_t tag) {
    epoll_event events[2]{};
    const int count = ::epoll_wait(epoll.get(), events, 2, 1000);
    subscriber.doorbells.drain();
    return std::any_of(events, events + std::max(count, 0),
                       [&](const epoll_event& event) { return event.data.u64 == tag; });
  };
  const auto ring_with = [&](const char* topic, std::uint32_t count) {
    Node publisher(daemon);
    publisher.publisher(topic);
    for (const Incoming& packet : publisher.wire.drain()) {
      if (packet.opcode() != Opcode::announce) continue;
      auto& fds = const_cast<std::vector<UniqueFd>&>(packet.fds);
      if (packet.as<wire::Announcement>().doorbell_count != count || fds.size() != 1 + count)
        return 1;
      const Doorbell doorbell =
          count == 2 ? Doorbell(std::move(fds[2]), std::move(fds[1])) : Doorbell(std::move(fds[1]));
      return doorbell.ring() == Doorbell::Rung::rung ? 0 : 2;
    }
    return 3;
  };
  std::filesystem::remove_all(doorbells);
  EXPECT_EQ(in_other_user([&] { return ring_with("/topic", 1); }), 0);
  EXPECT_TRUE(is_rung_by(2));
  EXPECT_EQ(ring_with("/topic", 2), 0);
  EXPECT_TRUE(is_rung_by(1));
  Node later(daemon);
  later.subscription("/later");
  EXPECT_EQ(ring_with("/later", 2), 0) << "the directory is recreated";

  std::filesystem::remove_all(doorbells);
  ASSERT_TRUE(daemon.wait_for_next(daemon.kill_worker()));
  EXPECT_EQ(ring_with("/topic", 2), 0) << "the eventfd was kept";
  EXPECT_TRUE(is_rung_by(1));
}

TEST(DaemonProtocol, NotifiesBothSidesOfAnotherType) {
  DaemonProcess daemon;
  Node publisher(daemon), wrong(daemon);
  const auto p = publisher.publisher("/topic");
  ASSERT_EQ(wrong.wire.open_wait_set().opcode(), Opcode::wait_set_opened);
  auto other_name = WireClient::endpoint("/topic", reliable, "test/msg/Other");
  const Incoming by_name = wrong.wire.ask(Opcode::create_subscription, other_name);
  EXPECT_EQ(by_name.refused_code(), Errc::type_mismatch);
  const auto text = [](const char* type, const char* layout) {
    return std::string(type) + " (layout " + layout + ") is asked for by process " +
           std::to_string(::getpid()) +
           ", test/msg/Type (layout 0x0000000000000001) is the type of /topic";
  };
  EXPECT_EQ(by_name.refused_text(), text("test/msg/Other", "0x0000000000000001"));
  auto packet = publisher.wire.expect<wire::Notice>(Opcode::notice);
  EXPECT_EQ(static_cast<Errc>(packet.code), Errc::type_mismatch);
  EXPECT_EQ(packet.kind, Kind::publisher);
  EXPECT_EQ(packet.index, p.index);
  EXPECT_EQ(packet.generation, p.generation);
  EXPECT_EQ(packet.policy, abi::QosPolicy::none);
  EXPECT_EQ(packet.text.text, by_name.refused_text());
  auto other_layout = WireClient::endpoint("/topic", reliable);
  other_layout.layout_hash = 2;
  EXPECT_EQ(wrong.wire.ask(Opcode::create_subscription, other_layout).refused_text(),
            text("test/msg/Type", "0x0000000000000002"));
  EXPECT_TRUE(publisher.wire.drain().empty()) << "notified once per process and topic";
  // Another domain is another topic.
  Node elsewhere(daemon, 7);
  EXPECT_EQ(elsewhere.wire.ask(Opcode::create_publisher, other_name).opcode(),
            Opcode::endpoint_created);
}

TEST(DaemonProtocol, NotifiesBothSidesOfAnIncompatibleQuality) {
  DaemonProcess daemon;
  Node publisher(daemon), subscriber(daemon);
  publisher.publisher("/topic", best_effort);
  const auto s = subscriber.subscription("/topic", reliable);
  for (Node* node : {&publisher, &subscriber}) {
    const auto notice = node->wire.expect<wire::Notice>(Opcode::notice);
    EXPECT_EQ(static_cast<Errc>(notice.code), Errc::qos_incompatible);
    EXPECT_EQ(notice.policy, abi::QosPolicy::reliability);
    EXPECT_STREQ(notice.text.text, "reliable is requested, best effort is offered");
    EXPECT_TRUE(node->wire.drain().empty()) << "not announced";
  }
  subscriber.subscription("/topic", best_effort);
  EXPECT_EQ(subscriber.wire.expect<wire::Announcement>(Opcode::announce).kind, Kind::publisher);
  const auto about = publisher.wire.expect<wire::Announcement>(Opcode::announce);
  EXPECT_NE(about.index, s.index);
  const Qos history{1, true, true, false, false};
  publisher.publisher("/durable", reliable);
  subscriber.subscription("/durable", history);
  const auto durable = subscriber.wire.expect<wire::Notice>(Opcode::notice);
  EXPECT_EQ(durable.policy, abi::QosPolicy::durability);
  EXPECT_STREQ(durable.text.text, "transient_local is requested, volatile is offered");
}

TEST(DaemonProtocol, RefusesImpossibleCreations) {
  DaemonProcess daemon;
  Node node(daemon);
  node.subscription("/topic");
  for (const char* name : {"topic", "/a//b", "/a b", "", "/1"})
    EXPECT_EQ(node.wire.create_publisher(name).refused_code(), Errc::invalid_name) << name;
  EXPECT_EQ(node.wire.create_publisher("/x", {1001, false, true, false, false}).refused_code(),
            Errc::depth_refused);
  for (const char* name : {"/x/", "/a//b", "$(id)", "/no\x1b]0;de", "/a b"}) {
    auto body = WireClient::endpoint("/x", reliable);
    body.node = wire_name(name);
    EXPECT_EQ(node.wire.ask(Opcode::create_publisher, body).refused_code(), Errc::invalid_name)
        << name;
  }
  EXPECT_EQ(node.wire.ask(Opcode::create_publisher, WireClient::endpoint("/x", reliable, "a\nb"))
                .refused_code(),
            Errc::invalid_name);
  auto unknown_executor = WireClient::endpoint("/x", reliable);
  unknown_executor.wait_set = 3;
  EXPECT_EQ(node.wire.ask(Opcode::create_subscription, unknown_executor).refused_code(),
            Errc::invalid_argument);
  EXPECT_EQ(node.wire.open_wait_set().refused_code(), Errc::protocol_violation)
      << "it is already open";
  EXPECT_EQ(node.wire.hello().refused_code(), Errc::protocol_violation);
  EXPECT_EQ(subscription_word(node.board, 1, 0), 0u) << "a failed creation leaves no topic behind";
}

TEST(DaemonProtocol, RefusesRequestsAboutOthersEndpoints) {
  DaemonProcess daemon;
  Node owner(daemon), thief(daemon);
  const auto p = owner.publisher("/topic");
  const auto s = owner.subscription("/topic");
  for (const Opcode opcode : {Opcode::leave, Opcode::drained}) {
    EXPECT_EQ(thief.wire.reference(opcode, Kind::publisher, p.topic, p.index, p.generation)
                  .refused_code(),
              Errc::protocol_violation);
    EXPECT_EQ(thief.wire.reference(opcode, Kind::subscription, s.topic, s.index, s.generation)
                  .refused_code(),
              Errc::protocol_violation);
  }
  EXPECT_EQ(owner.wire.reference(Opcode::leave, Kind::publisher, p.topic, p.index, p.generation + 1)
                .refused_code(),
            Errc::protocol_violation);
  EXPECT_EQ(owner.wire.reference(Opcode::leave, Kind::publisher, 4000, 3, 1).refused_code(),
            Errc::protocol_violation);
  EXPECT_EQ(
      owner.wire.reference(Opcode::drained, Kind::subscription, s.topic, s.index, s.generation)
          .refused_text(),
      "the subscription has not left");
  EXPECT_EQ(abi::state_of(publisher_word(owner.board, p.topic, p.index)), abi::BoardState::active);
}

TEST(DaemonProtocol, ReusesThePlaceOfASubscriptionOnlyWhenItIsUnlinked) {
  DaemonProcess daemon;
  Node subscriber(daemon), publisher(daemon);
  const auto p = publisher.publisher("/topic");
  const auto s = subscriber.subscription("/topic");
  subscriber.wire.drain();
  publisher.wire.drain();
  const auto state = [&](std::uint64_t index) {
    return abi::state_of(subscription_word(publisher.board, s.topic, index));
  };
  // A process may leave any value in an extent, near and far.
  const std::uint64_t last = abi::link_block_count - 1;
  const std::uint64_t places[] = {s.extent, s.extent + abi::link_offset(0),
                                  s.extent + abi::link_offset(last) + abi::far_hold_offset(0)};
  for (const std::uint64_t place : places)
    SharedMemory::word(subscriber.region.base(), place).store(~std::uint64_t{0});
  EXPECT_EQ(
      subscriber.wire.reference(Opcode::leave, Kind::subscription, s.topic, s.index, s.generation)
          .opcode(),
      Opcode::done);
  EXPECT_EQ(state(s.index), abi::BoardState::leaving);
  const auto kick = publisher.wire.expect<wire::Reference>(Opcode::kick);
  EXPECT_EQ(kick.kind, Kind::publisher);
  EXPECT_EQ(kick.index, p.index);
  EXPECT_EQ(kick.generation, p.generation);
  // A new subscription lies elsewhere while the old one drains.
  const auto second = subscriber.subscription("/topic");
  EXPECT_NE(second.index, s.index);
  EXPECT_NE(second.extent, s.extent);
  EXPECT_EQ(
      subscriber.wire.reference(Opcode::drained, Kind::subscription, s.topic, s.index, s.generation)
          .opcode(),
      Opcode::done);
  EXPECT_EQ(state(s.index), abi::BoardState::free);
  publisher.wire.expect<wire::Announcement>(Opcode::announce);  // of the second
  const auto forget = publisher.wire.expect<wire::Reference>(Opcode::forget);
  EXPECT_EQ(forget.kind, Kind::subscription);
  EXPECT_EQ(forget.index, s.index);
  EXPECT_EQ(forget.generation, s.generation);
  const auto third = subscriber.subscription("/topic");
  EXPECT_NE(third.index, s.index) << "the publisher has not unlinked";
  publisher.wire.drain();
  publisher.wire.unlinked(Kind::subscription, s.topic, s.index, s.generation);
  publisher.wire.drain();  // the daemon has handled it
  const auto fourth = subscriber.subscription("/topic");
  EXPECT_EQ(fourth.index, s.index);
  EXPECT_EQ(fourth.extent, s.extent);
  EXPECT_GT(fourth.generation, third.generation);
  for (const std::uint64_t place : places)
    EXPECT_EQ(word(subscriber.region, place), 0u) << "lines and far hold words are zero at join";
}

TEST(DaemonProtocol, ReusesThePlaceOfAPublisherOnlyWhenBothSidesAreDone) {
  DaemonProcess daemon;
  Node subscriber(daemon), publisher(daemon);
  const auto s = subscriber.subscription("/topic");
  const auto p = publisher.publisher("/topic");
  subscriber.wire.drain();
  publisher.wire.drain();
  const auto state = [&] {
    return abi::state_of(publisher_word(publisher.board, p.topic, p.index));
  };
  // As if it had published five messages.
  const std::uint64_t head = abi::pack_entry(p.first_sequence + 5, 3);
  SharedMemory::word(publisher.region.base(), p.extent).store(head);
  const auto say = [&](Opcode opcode) {
    return publisher.wire.reference(opcode, Kind::publisher, p.topic, p.index, p.generation);
  };
  EXPECT_EQ(say(Opcode::leave).opcode(), Opcode::done);
  EXPECT_EQ(state(), abi::BoardState::orphan);
  const auto orphaned = subscriber.wire.expect<wire::Orphaned>(Opcode::orphaned);
  EXPECT_EQ(orphaned.index, p.index);
  EXPECT_EQ(orphaned.generation, p.generation);
  EXPECT_EQ(orphaned.final_head, head);
  EXPECT_EQ(say(Opcode::drained).refused_text(), "the publisher's word is not free yet");
  EXPECT_EQ(say(Opcode::leave).refused_code(), Errc::protocol_violation) << "a second leave";
  EXPECT_NE(publisher.publisher("/topic").index, p.index);
  subscriber.wire.drain();
  publisher.wire.drain();
  subscriber.wire.unlinked(Kind::publisher, p.topic, p.index, p.generation);
  const auto kick = publisher.wire.expect<wire::Reference>(Opcode::kick);
  EXPECT_EQ(kick.index, p.index);
  EXPECT_EQ(state(), abi::BoardState::free);
  EXPECT_NE(publisher.publisher("/topic").index, p.index) << "its owner still frees messages there";
  EXPECT_EQ(say(Opcode::drained).opcode(), Opcode::done);
  const auto again = publisher.publisher("/topic");
  EXPECT_EQ(again.index, p.index);
  EXPECT_EQ(again.extent, p.extent);
  EXPECT_EQ(word(publisher.region, again.extent), abi::pack_entry(again.first_sequence, 0));
  static_cast<void>(s);
}

TEST(DaemonProtocol, IgnoresAnUnlinkedThatCrossesAnAnnouncement) {
  DaemonProcess daemon;
  Node subscriber(daemon), publisher(daemon);
  const auto p = publisher.publisher("/topic");
  const auto s = subscriber.subscription("/topic");
  const std::uint64_t before = subscriber.wire.seen();  // the announcement is not read yet
  const auto leave = [&] {
    return publisher.wire.reference(Opcode::leave, Kind::publisher, p.topic, p.index, p.generation);
  };
  ASSERT_EQ(leave().opcode(), Opcode::done);
  publisher.wire.drain();
  subscriber.wire.unlinked(Kind::publisher, p.topic, p.index, p.generation, before);
  subscriber.wire.drain();
  EXPECT_EQ(abi::state_of(publisher_word(publisher.board, p.topic, p.index)),
            abi::BoardState::orphan)
      << "it acknowledged an older announcement";
  subscriber.wire.unlinked(Kind::publisher, p.topic, p.index, p.generation + 9);
  subscriber.wire.drain();
  EXPECT_EQ(abi::state_of(publisher_word(publisher.board, p.topic, p.index)),
            abi::BoardState::orphan)
      << "another generation";
  subscriber.wire.unlinked(Kind::publisher, p.topic, p.index, p.generation);
  subscriber.wire.drain();
  EXPECT_EQ(abi::state_of(publisher_word(publisher.board, p.topic, p.index)),
            abi::BoardState::free);
  subscriber.wire.unlinked(Kind::publisher, p.topic, p.index, p.generation, 1u << 20);
  const auto unasked = subscriber.wire.drain();
  ASSERT_EQ(unasked.size(), 1u);
  EXPECT_EQ(unasked[0].refused_code(), Errc::protocol_violation)
      << "it acknowledged more than the daemon sent";
  static_cast<void>(s);
}

TEST(DaemonProtocol, RefusesToUnlinkARegionWithLinkedEndpoints) {
  DaemonProcess daemon;
  Node subscriber(daemon), publisher(daemon);
  publisher.publisher("/topic");
  subscriber.subscription("/topic");
  subscriber.wire.drain();
  subscriber.wire.unlinked(Kind::region, 0, publisher.welcome.client,
                           publisher.welcome.client_generation);
  const auto unasked = subscriber.wire.drain();
  ASSERT_EQ(unasked.size(), 1u);
  EXPECT_EQ(unasked[0].refused_text(), "the process still has an endpoint of this region linked");
}

TEST(DaemonProtocol, RaisesThePublishersSlotsForADeepSubscription) {
  DaemonProcess daemon;
  Node publisher(daemon), subscriber(daemon);
  const auto p = publisher.publisher("/topic");
  EXPECT_EQ(p.slot_count, abi::near_slot_count);
  const auto s = subscriber.subscription("/topic", {900, false, true, false, false});
  const std::uint64_t slots =
      word(publisher.board, abi::topic_offset(p.topic) + abi::publisher_entry_offset(p.index) +
                                offsetof(abi::PublisherEntry, slot_count));
  EXPECT_GE(slots, 900u + 4u + 2u);
  // Both ends of the raised slots, and of the far hold words, are memory and zero.
  EXPECT_EQ(word(publisher.region, p.extent + abi::slot_offset(abi::ring_count, slots - 1)), 0u);
  EXPECT_EQ(word(subscriber.region, s.extent + abi::link_offset(p.index) + abi::far_hold_offset(0)),
            0u);
}
}  // namespace
}  // namespace agnocast::test
