// SPDX-License-Identifier: Apache-2.0
//
// Goal: every request is answered as docs/control-plane.md says, announcements come in its order
// with descriptors that work and give no more than they should, and nothing that one client sends
// disturbs another.
// Method: raw clients against the real daemon. "Nothing more came" is asked, not waited for: the
// answer to a harmless question comes after everything that was sent before it.

#include <agnocast/abi/board.hpp>
#include <agnocast/abi/client_region.hpp>
#include <base/doorbell.hpp>
#include <base/mapping.hpp>
#include <base/memory_policy.hpp>
#include <tests/support/daemon_process.hpp>
#include <tests/support/wire_client.hpp>
#include <tests/support/wire_dump.hpp>

#include <fcntl.h>
#include <grp.h>
#include <gtest/gtest.h>
#include <sys/epoll.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <functional>
#include <memory>
#include <random>

namespace agnocast::test {
namespace {

using abi::Qos;
using wire::Kind;
using wire::Opcode;

constexpr uid_t other_uid = 65534;
constexpr Qos reliable{1, false, true, false, false};
constexpr Qos best_effort{1, false, false, false, false};

Mapping map_region(const UniqueFd& fd, Mapping::Access access) {
  return std::move(Mapping::map(fd.get(), std::uint64_t{1} << 30, access).value());
}
std::uint64_t word(const Mapping& mapping, std::uint64_t offset) {
  return SharedMemory::word(mapping.base(), offset).load();
}
std::uint64_t publisher_word(const Mapping& board, std::uint32_t topic, std::uint64_t index) {
  return word(board, abi::topic_offset(topic) + abi::publisher_entry_offset(index));
}
std::uint64_t subscription_word(const Mapping& board, std::uint32_t topic, std::uint64_t index) {
  return word(board, abi::topic_offset(topic) +
                         abi::subscription_entry_offset(abi::publisher_count_max, index));
}

// Runs in a process of another user (as far as the test may); what it returns is the exit status.
int in_other_user(const std::function<int()>& body) {
  const pid_t pid = ::fork();
  if (pid == 0) {
    if (::setgroups(0, nullptr) != 0 || ::setgid(other_uid) != 0 || ::setuid(other_uid) != 0)
      ::_exit(99);
    ::_exit(body());
  }
  int status = 0;
  ::waitpid(pid, &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

/// A connected and greeted client with its board and region mapped.
struct Node {
  explicit Node(const DaemonProcess& daemon, std::uint64_t domain = 0)
      : wire(daemon.socket_path()) {
    Incoming answer = wire.hello(abi::fingerprint(), domain);
    if (answer.opcode() != Opcode::welcome || answer.fds.size() != 2) {
      ADD_FAILURE() << "no welcome: " << answer.refused_text();
      return;
    }
    welcome = answer.as<wire::Welcome>();
    board = std::move(
        Mapping::map(answer.fds[0].get(), abi::board_bytes, Mapping::Access::read).value());
    region = map_region(answer.fds[1], Mapping::Access::read_write);
    fds = std::move(answer.fds);
  }
  wire::EndpointCreated created(const Incoming& answer) {
    EXPECT_EQ(answer.opcode(), Opcode::endpoint_created) << answer.refused_text();
    return answer.opcode() == Opcode::endpoint_created ? answer.as<wire::EndpointCreated>()
                                                       : wire::EndpointCreated{};
  }
  wire::EndpointCreated publisher(std::string_view topic, const Qos& qos = reliable) {
    return created(wire.create_publisher(topic, qos));
  }
  wire::EndpointCreated subscription(std::string_view topic, const Qos& qos = reliable) {
    if (!executor) {
      Incoming answer = wire.open_executor();
      EXPECT_EQ(answer.opcode(), Opcode::executor_opened) << answer.refused_text();
      EXPECT_EQ(answer.fds.size(), 2u);
      if (answer.fds.size() == 2)
        bells = DoorbellReceiver(std::move(answer.fds[0]), std::move(answer.fds[1]));
      executor = true;
    }
    return created(wire.create_subscription(topic, qos));
  }

  WireClient wire;
  wire::Welcome welcome{};
  Mapping board, region;
  std::vector<UniqueFd> fds;
  DoorbellReceiver bells;
  bool executor = false;
};

TEST(DaemonProtocol, WelcomesWithBoardRegionAndArena) {
  DaemonProcess daemon;
  Node node(daemon);
  EXPECT_EQ(node.welcome.fingerprint, abi::fingerprint());
#if !defined(__SANITIZE_THREAD__)  // there the test's daemon is told another base
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
      << "nothing else goes without hello";
  EXPECT_TRUE(daemon.wait_for_log("code=layout_mismatch"));
}

// A hello that a child says on the connection of its parent: whose process is it?
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
    EXPECT_EQ(client.next().opcode(), Opcode::welcome) << "the process that connected is known";
  }
  DaemonProcess daemon({.without_peer_pidfd = true});
  WireClient client(daemon.socket_path());
  say_hello_in_a_child(client);
  const Incoming refused = client.next();
  EXPECT_EQ(refused.refused_code(), Errc::permission_denied);
  EXPECT_EQ(refused.refused_text(), "the process that connected is not the one that says hello");
  EXPECT_EQ(client.hello().opcode(), Opcode::welcome) << "itself it may";
  EXPECT_EQ(client.create_publisher("/topic").opcode(), Opcode::endpoint_created);
}

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
            abi::MemberState::active);

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
  ASSERT_TRUE(subscriber.bells.add_to(epoll.get(), 1, 2));
  const Doorbell bell(std::move(fds[2]), std::move(fds[1]));
  EXPECT_EQ(bell.ring(), Doorbell::Rung::rung);
  epoll_event event{};
  ASSERT_EQ(::epoll_wait(epoll.get(), &event, 1, 1000), 1);
  EXPECT_EQ(event.data.u64, 1u);

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

  // A late subscription hears of all publishers first, from their present head.
  const auto late = subscriber.subscription("/topic");
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

TEST(DaemonProtocol, AnnouncesAWindowBeforeItsOwnerHasIt) {
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

  // The same memory behind both descriptors; asked again, the same window again.
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

TEST(DaemonProtocol, GivesAnotherUserTheDatagramBellAlone) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and another user";
  DaemonProcess daemon;
  Node subscriber(daemon);
  subscriber.subscription("/topic");
  const UniqueFd epoll(::epoll_create1(EPOLL_CLOEXEC));
  ASSERT_TRUE(subscriber.bells.add_to(epoll.get(), 1, 2));
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
  EXPECT_EQ(event.data.u64, 2u);
}

TEST(DaemonProtocol, TellsBothSidesOfAnotherType) {
  DaemonProcess daemon;
  Node publisher(daemon), wrong(daemon);
  const auto p = publisher.publisher("/topic");
  ASSERT_EQ(wrong.wire.open_executor().opcode(), Opcode::executor_opened);
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
  EXPECT_TRUE(publisher.wire.drain().empty()) << "told once per process and topic";
  // Another domain is another topic.
  Node elsewhere(daemon, 7);
  EXPECT_EQ(elsewhere.wire.ask(Opcode::create_publisher, other_name).opcode(),
            Opcode::endpoint_created);
}

TEST(DaemonProtocol, TellsBothSidesOfAnIncompatibleQuality) {
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

TEST(DaemonProtocol, RefusesWhatCannotBeCreated) {
  DaemonProcess daemon;
  Node node(daemon);
  node.subscription("/topic");
  for (const char* name : {"topic", "/a//b", "/a b", "", "/1"})
    EXPECT_EQ(node.wire.create_publisher(name).refused_code(), Errc::invalid_name) << name;
  EXPECT_EQ(node.wire.create_publisher("/x", {1001, false, true, false, false}).refused_code(),
            Errc::depth_refused);
  auto unknown_executor = WireClient::endpoint("/x", reliable);
  unknown_executor.executor = 3;
  EXPECT_EQ(node.wire.ask(Opcode::create_subscription, unknown_executor).refused_code(),
            Errc::invalid_argument);
  EXPECT_EQ(node.wire.open_executor().refused_code(), Errc::protocol_violation) << "open already";
  EXPECT_EQ(node.wire.hello().refused_code(), Errc::protocol_violation);
  EXPECT_EQ(subscription_word(node.board, 1, 0), 0u) << "a failed creation leaves no topic behind";
}

TEST(DaemonProtocol, RefusesToSpeakOfOthersEndpoints) {
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
  EXPECT_EQ(abi::state_of(publisher_word(owner.board, p.topic, p.index)), abi::MemberState::active);
}

TEST(DaemonProtocol, LetsASubscriptionLeaveAndUsesItsPlaceOnlyWhenItIsUnlinked) {
  DaemonProcess daemon;
  Node subscriber(daemon), publisher(daemon);
  const auto p = publisher.publisher("/topic");
  const auto s = subscriber.subscription("/topic");
  subscriber.wire.drain();
  publisher.wire.drain();
  const auto state = [&](std::uint64_t index) {
    return abi::state_of(subscription_word(publisher.board, s.topic, index));
  };
  // Whatever a process leaves in an extent, near and far.
  const std::uint64_t places[] = {s.extent,
                                  s.extent + abi::far_hold_offset(abi::publisher_count_max, 3, 0)};
  for (const std::uint64_t place : places)
    SharedMemory::word(subscriber.region.base(), place).store(~std::uint64_t{0});
  EXPECT_EQ(
      subscriber.wire.reference(Opcode::leave, Kind::subscription, s.topic, s.index, s.generation)
          .opcode(),
      Opcode::done);
  EXPECT_EQ(state(s.index), abi::MemberState::leaving);
  const auto kick = publisher.wire.expect<wire::Reference>(Opcode::kick);
  EXPECT_EQ(kick.kind, Kind::publisher);
  EXPECT_EQ(kick.index, p.index);
  EXPECT_EQ(kick.generation, p.generation);
  // A new one while the old one drains lies elsewhere.
  const auto second = subscriber.subscription("/topic");
  EXPECT_NE(second.index, s.index);
  EXPECT_NE(second.extent, s.extent);
  EXPECT_EQ(
      subscriber.wire.reference(Opcode::drained, Kind::subscription, s.topic, s.index, s.generation)
          .opcode(),
      Opcode::done);
  EXPECT_EQ(state(s.index), abi::MemberState::free);
  publisher.wire.expect<wire::Announcement>(Opcode::announce);  // of the second
  const auto forget = publisher.wire.expect<wire::Reference>(Opcode::forget);
  EXPECT_EQ(forget.kind, Kind::subscription);
  EXPECT_EQ(forget.index, s.index);
  EXPECT_EQ(forget.generation, s.generation);
  const auto third = subscriber.subscription("/topic");
  EXPECT_NE(third.index, s.index) << "the publisher has not unlinked";
  publisher.wire.drain();
  publisher.wire.unlinked(Kind::subscription, s.topic, s.index, s.generation);
  publisher.wire.drain();  // it has been handled
  const auto fourth = subscriber.subscription("/topic");
  EXPECT_EQ(fourth.index, s.index);
  EXPECT_EQ(fourth.extent, s.extent);
  EXPECT_GT(fourth.generation, third.generation);
  for (const std::uint64_t place : places)
    EXPECT_EQ(word(subscriber.region, place), 0u) << "lines and far hold words are zero at join";
}

TEST(DaemonProtocol, LetsAPublisherLeaveAndUsesItsPlaceOnlyWhenBothSidesAreDone) {
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
  EXPECT_EQ(state(), abi::MemberState::orphan);
  const auto orphaned = subscriber.wire.expect<wire::Orphaned>(Opcode::orphaned);
  EXPECT_EQ(orphaned.index, p.index);
  EXPECT_EQ(orphaned.generation, p.generation);
  EXPECT_EQ(orphaned.final_head, head);
  EXPECT_EQ(say(Opcode::drained).refused_text(), "the publisher's word is not free yet");
  EXPECT_EQ(say(Opcode::leave).refused_code(), Errc::protocol_violation) << "twice";
  EXPECT_NE(publisher.publisher("/topic").index, p.index);
  subscriber.wire.drain();
  publisher.wire.drain();
  subscriber.wire.unlinked(Kind::publisher, p.topic, p.index, p.generation);
  const auto kick = publisher.wire.expect<wire::Reference>(Opcode::kick);
  EXPECT_EQ(kick.index, p.index);
  EXPECT_EQ(state(), abi::MemberState::free);
  EXPECT_NE(publisher.publisher("/topic").index, p.index) << "its owner still frees messages there";
  EXPECT_EQ(say(Opcode::drained).opcode(), Opcode::done);
  const auto again = publisher.publisher("/topic");
  EXPECT_EQ(again.index, p.index);
  EXPECT_EQ(again.extent, p.extent);
  EXPECT_EQ(word(publisher.region, again.extent), abi::pack_entry(again.first_sequence, 0));
  static_cast<void>(s);
}

TEST(DaemonProtocol, IgnoresAnUnlinkedThatCrossedAnAnnouncement) {
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
            abi::MemberState::orphan)
      << "what was announced later is not unlinked";
  subscriber.wire.unlinked(Kind::publisher, p.topic, p.index, p.generation + 9);
  subscriber.wire.drain();
  EXPECT_EQ(abi::state_of(publisher_word(publisher.board, p.topic, p.index)),
            abi::MemberState::orphan)
      << "another generation";
  subscriber.wire.unlinked(Kind::publisher, p.topic, p.index, p.generation);
  subscriber.wire.drain();
  EXPECT_EQ(abi::state_of(publisher_word(publisher.board, p.topic, p.index)),
            abi::MemberState::free);
  subscriber.wire.unlinked(Kind::publisher, p.topic, p.index, p.generation, 1u << 20);
  const auto unasked = subscriber.wire.drain();
  ASSERT_EQ(unasked.size(), 1u);
  EXPECT_EQ(unasked[0].refused_code(), Errc::protocol_violation) << "seen more than was sent";
  static_cast<void>(s);
}

TEST(DaemonProtocol, RefusesARegionUnlinkedWhileSomethingOfItIsLinked) {
  DaemonProcess daemon;
  Node subscriber(daemon), publisher(daemon);
  publisher.publisher("/topic");
  subscriber.subscription("/topic");
  subscriber.wire.drain();
  subscriber.wire.unlinked(Kind::region, 0, publisher.welcome.client,
                           publisher.welcome.client_generation);
  const auto unasked = subscriber.wire.drain();
  ASSERT_EQ(unasked.size(), 1u);
  EXPECT_EQ(unasked[0].refused_text(), "something of this region is linked");
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
  EXPECT_EQ(word(subscriber.region,
                 s.extent + abi::far_hold_offset(abi::publisher_count_max, p.index, 0)),
            0u);
}

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
                            Opcode::open_executor,
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
      if (!garbage.send_bytes(packet, std::span(fds).first(random() % 8 == 0 ? 2 : 0))) break;
    }
    honest.round();
    if (testing::Test::HasFailure()) break;
  }
  ASSERT_TRUE(eventually([&] { return daemon.descriptor_count() == fds_before; }))
      << daemon.descriptor_count() << " instead of " << fds_before;
  EXPECT_TRUE(daemon.is_running());
  honest.round();
}

TEST(DaemonProtocol, UsesNoMemoryForPlacesThatAreOnlyNamed) {
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

// Well-formed requests in any order, of one's own things and of others': whatever somebody claims
// to have left, drained or unlinked, the daemon's own invariants hold (it aborts when one does
// not), and when all are gone nothing is left.
TEST(DaemonProtocol, SurvivesAnyOrderOfPlausibleRequests) {
  for (const std::uint64_t seed : {1u, 2u, 3u}) {
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
    unsigned accepted = 0, lives = 0;
    const std::size_t fds = [&] {
      Node first(daemon);  // what is made once is made now; its own: socket, pidfd, region twice
      return daemon.descriptor_count() - 4;
    }();
    for (int step = 0; step < 6000 && !HasFailure(); ++step) {
      Process& process = processes[random() % processes.size()];
      if (!process.wire || random() % 100 == 0) {
        process.wire = std::make_unique<WireClient>(daemon.socket_path());
        const Incoming answer = process.wire->hello();
        ASSERT_EQ(answer.opcode(), Opcode::welcome) << answer.refused_text();
        process.welcome = answer.as<wire::Welcome>();
        process.wire->open_executor();
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
    EXPECT_GT(lives, 30u);
    processes.clear();
    ASSERT_TRUE(eventually([&] { return daemon.descriptor_count() == fds; }))
        << daemon.descriptor_count() << " descriptors, " << fds << " at the beginning";
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
  wire::WindowRequest request{};
  request.header = {Opcode::open_window, sizeof request, 99};
  const int fd = node.fds[0].get();
  ASSERT_TRUE(node.wire.send_bytes(std::as_bytes(std::span(&request, 1)), std::span(&fd, 1)));
  const auto refused = node.wire.next();
  EXPECT_EQ(refused.header().request, 99u);
  EXPECT_EQ(refused.refused_text(), "descriptors came with a request");
  EXPECT_EQ(node.wire.open_window(0).opcode(), Opcode::window_opened) << "it may go on";
  honest.round();
}

TEST(DaemonProtocol, TakesAWindowThatADaemonMadeAndNothingElse) {
  DaemonProcess former, daemon;
  Node owner(former);
  Incoming opened = owner.wire.open_window(0);
  ASSERT_EQ(opened.opcode(), Opcode::window_opened);
  const auto window = opened.as<wire::WindowOpened>();
  const int writer = opened.fds[0].get(), reader = opened.fds[1].get();

  Node node(daemon);
  EXPECT_EQ(node.wire.bring_window(window, reader).refused_code(), Errc::permission_denied)
      << "everybody who reads from its owner has it like that";
  EXPECT_EQ(node.wire.bring_window(window, node.fds[0].get()).refused_code(),
            Errc::permission_denied)
      << "a region";
  const UniqueFd own(::memfd_create("own", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  ASSERT_EQ(::ftruncate(own.get(), static_cast<off_t>(window.bytes)), 0);
  EXPECT_EQ(node.wire.bring_window(window, own.get()).refused_code(), Errc::permission_denied)
      << "its owner could cut it off under its readers";
  auto elsewhere = window;
  elsewhere.base += window.bytes / 2;
  EXPECT_EQ(node.wire.bring_window(elsewhere, writer).refused_code(), Errc::arena_occupied);
  elsewhere.base = 1 << 21;
  EXPECT_EQ(node.wire.bring_window(elsewhere, writer).refused_code(), Errc::arena_occupied);
  auto later = window;
  later.window = 1;
  EXPECT_EQ(node.wire.bring_window(later, writer).refused_code(), Errc::protocol_violation);

  EXPECT_EQ(node.wire.bring_window(window, writer).opcode(), Opcode::done);
  EXPECT_EQ(node.wire.bring_window(window, writer).opcode(), Opcode::done) << "it is there";
  Node other(daemon);
  EXPECT_EQ(other.wire.bring_window(window, writer).refused_code(), Errc::arena_occupied);
  const auto next = node.wire.open_window(1).as<wire::WindowOpened>();
  EXPECT_NE(next.base, window.base);
  EXPECT_EQ(next.first, 0u) << "one group";
}

TEST(DaemonProtocol, KeepsWhatASlowClientHasNotReadInOrder) {
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
  ASSERT_EQ(deaf.open_executor().opcode(), Opcode::executor_opened);
  const std::size_t before = daemon.descriptor_count();
  constexpr std::uint64_t count = 1'000;
  for (std::uint64_t i = 0; i < count; ++i) {
    deaf.send(Opcode::open_window, wire::WindowRequest{});
    wire::ExecutorRequest executor{};
    executor.header = {Opcode::open_executor, sizeof executor, (i + 1) | wire::asked_again};
    ASSERT_TRUE(deaf.send_bytes(std::as_bytes(std::span(&executor, 1))));
  }
  ASSERT_TRUE(eventually([&] {
    return wire_dump(daemon.socket_path()).daemon.counters.requests_answered_again == 2 * count;
  }));
  EXPECT_LE(daemon.descriptor_count(), before + 16);
}

std::uint64_t say_blocked(WireClient& client, std::uint64_t base, std::uint64_t bytes) {
  wire::Blocked body{};
  body.base = base;
  body.bytes = bytes;
  body.what = wire_name("a test");
  return client.send(Opcode::blocked, body);
}

TEST(DaemonProtocol, AsksAHeapToMoveForAReaderThatCannotMapIt) {
  DaemonProcess daemon;
  WireClient publisher(daemon.socket_path()), reader(daemon.socket_path());
  publisher.hello();
  const auto window = publisher.open_window(0).as<wire::WindowOpened>();
  EXPECT_EQ(window.first, 0u);
  ASSERT_EQ(publisher.create_publisher("/topic").opcode(), Opcode::endpoint_created);
  reader.hello();
  say_blocked(reader, window.base + window.bytes / 2, abi::window_granule_bytes);
  say_blocked(reader, window.base + window.bytes, window.bytes);
  reader.open_executor();
  ASSERT_EQ(reader.create_subscription("/topic").opcode(), Opcode::endpoint_created);

  const auto announced = reader.expect<wire::Announcement>(Opcode::announce);
  ASSERT_EQ(announced.window_count, 1u) << "it is announced like any other";
  const auto told = reader.expect<wire::Notice>(Opcode::notice);
  EXPECT_EQ(told.code, static_cast<std::uint32_t>(Errc::arena_occupied));
  EXPECT_NE(std::string(told.text.text).find("a test"), std::string::npos) << told.text.text;
  EXPECT_EQ(publisher.expect<wire::Notice>(Opcode::notice).code, told.code);
  EXPECT_EQ(publisher.expect<wire::MoveHeap>(Opcode::move_heap).window, 1u);

  const auto next = publisher.open_window(1).as<wire::WindowOpened>();
  EXPECT_EQ(next.first, 1u) << "a group of its own";
  EXPECT_EQ(next.base, window.base + 2 * window.bytes) << "where the reader has nothing";
  const auto again = publisher.open_window(1).as<wire::WindowOpened>();
  EXPECT_EQ(again.first, 1u);
  const auto more = publisher.open_window(2).as<wire::WindowOpened>();
  EXPECT_EQ(more.first, 1u) << "growth within the group";
  EXPECT_EQ(reader.expect<wire::WindowAnnounced>(Opcode::window_announced).first, 1u);
  EXPECT_EQ(reader.expect<wire::WindowAnnounced>(Opcode::window_announced).first, 1u);
}

TEST(DaemonProtocol, TellsPublishersOnceOfARangeThatIsSaidAgainAndAgain) {
  DaemonProcess daemon;
  WireClient publisher(daemon.socket_path()), reader(daemon.socket_path());
  publisher.hello();
  const auto window = publisher.open_window(0).as<wire::WindowOpened>();
  ASSERT_EQ(publisher.create_publisher("/topic").opcode(), Opcode::endpoint_created);
  reader.hello();
  reader.open_executor();
  ASSERT_EQ(reader.create_subscription("/topic").opcode(), Opcode::endpoint_created);
  for (int i = 0; i < 100; ++i) say_blocked(reader, window.base, window.bytes);
  reader.drain();
  std::size_t notices = 0;
  for (const Incoming& packet : publisher.drain()) notices += packet.opcode() == Opcode::notice;
  EXPECT_EQ(notices, 1u);
}

TEST(DaemonProtocol, RefusesBlockedRangesThatCannotBeAndLetsNobodyBlockEverything) {
  DaemonProcess daemon;
  WireClient hostile(daemon.socket_path()), honest(daemon.socket_path());
  const auto arena = hostile.hello().as<wire::Welcome>();
  const auto refused = [&](std::uint64_t base, std::uint64_t bytes) {
    const std::uint64_t request = say_blocked(hostile, base, bytes);
    bool was = false;
    for (const Incoming& packet : hostile.drain())
      was = was || (packet.header().request == request && packet.opcode() == Opcode::refused);
    return was;
  };
  EXPECT_TRUE(refused(0, 4096));
  EXPECT_TRUE(refused(arena.arena_base, 0));
  EXPECT_TRUE(refused(arena.arena_base, arena.arena_bytes + 1));
  EXPECT_TRUE(refused(~std::uint64_t{0}, ~std::uint64_t{0}));
  EXPECT_FALSE(refused(arena.arena_base, arena.arena_bytes)) << "all of it";
  for (std::uint64_t i = 1; i < abi::blocked_count_max; ++i)
    EXPECT_FALSE(refused(arena.arena_base, i * abi::window_granule_bytes)) << i;
  EXPECT_TRUE(refused(arena.arena_base, 4096)) << "one too many";
  EXPECT_EQ(hostile.open_window(0).refused_code(), Errc::arena_occupied) << "in its own way";
  honest.hello();
  EXPECT_EQ(honest.open_window(0).opcode(), Opcode::window_opened);
}

TEST(DaemonProtocol, DisconnectsAClientThatDoesNotRead) {
  DaemonProcess daemon({.config = "[quota]\nheld_messages = \"unlimited\"\n"});
  HonestPair honest(daemon);
  WireClient deaf(daemon.socket_path());
  deaf.hello();
  // Every question is answered; nobody reads the answers.
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
