// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process that lost its connection rejoins as the same client, gets every event since
// then, and each repeated request is carried out once.
// Method: raw clients against the real daemon; connections are closed and opened again. "Nothing
// more came" is asked, not waited for.

#include <agnocast/abi/board.hpp>
#include <base/descriptors/doorbell.hpp>
#include <base/memory/mapping.hpp>
#include <base/memory/memory_policy.hpp>
#include <region/views.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/soon.hpp>
#include <tests/support/wire/wire_client.hpp>
#include <tests/support/wire/wire_dump.hpp>

#include <gtest/gtest.h>
#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <memory>

namespace agnocast::test {
namespace {

using abi::Qos;
using wire::Kind;
using wire::Opcode;

constexpr Qos reliable{1, false, true, false, false};

/// A client whose region stays mapped, so that the end of its connection is not its end.
struct Node {
  explicit Node(const DaemonProcess& daemon) : path(daemon.socket_path()), wire(path) {
    Incoming answer = wire.hello();
    if (answer.opcode() != Opcode::welcome || answer.fds.size() != 2) {
      ADD_FAILURE() << "no welcome: " << answer.refused_text();
      return;
    }
    welcome = answer.as<wire::Welcome>();
    board = std::move(
        Mapping::map(answer.fds[0].get(), abi::board_bytes, Mapping::Access::read).value());
    region = std::move(
        Mapping::map(answer.fds[1].get(), welcome.client_region_bytes, Mapping::Access::read_write)
            .value());
  }
  static wire::EndpointCreated made(const Incoming& answer) {
    EXPECT_EQ(answer.opcode(), Opcode::endpoint_created) << answer.refused_text();
    return answer.opcode() == Opcode::endpoint_created ? answer.as<wire::EndpointCreated>()
                                                       : wire::EndpointCreated{};
  }
  wire::EndpointCreated publisher(std::string_view topic) {
    return made(wire.create_publisher(topic, reliable));
  }
  wire::EndpointCreated subscription(std::string_view topic) {
    if (doorbells.empty()) doorbells = std::move(wire.open_wait_set().fds);
    EXPECT_EQ(doorbells.size(), 2u);
    return made(wire.create_subscription(topic, reliable));
  }
  void lose_connection() { wire.socket().close(); }
  void come_back() {
    wire.connect_again(path);
    const Incoming answer = wire.rejoin(welcome);
    ASSERT_EQ(answer.opcode(), Opcode::rejoined) << answer.refused_text();
    EXPECT_EQ(answer.as<wire::Rejoined>().incarnation, welcome.incarnation);
  }

  std::string path;
  WireClient wire;
  wire::Welcome welcome{};
  Mapping board, region;
  std::vector<UniqueFd> doorbells;
};

/// Returns all unasked packets of one kind.
template <class Body>
std::vector<Body> of_kind(const std::deque<Incoming>& packets, Opcode opcode) {
  std::vector<Body> found;
  for (const Incoming& packet : packets) {
    if (packet.opcode() == opcode) found.push_back(packet.as<Body>());
  }
  return found;
}

std::string order_of(const std::deque<Incoming>& packets) {
  std::string order;
  for (const Incoming& packet : packets) {
    switch (packet.opcode()) {
      case Opcode::own:
        order += "own ";
        break;
      case Opcode::announce:
        order += "announce ";
        break;
      case Opcode::orphaned:
        order += "orphaned ";
        break;
      case Opcode::forget:
        order += "forget ";
        break;
      case Opcode::region:
        order += "region ";
        break;
      default:
        order += std::to_string(static_cast<unsigned>(packet.opcode())) + " ";
        break;
    }
  }
  return order;
}

TEST(DaemonRejoin, AProcessFindsItsSessionUnchanged) {
  DaemonProcess daemon;
  Node sender(daemon), receiver(daemon);
  const auto publisher = sender.publisher("/t");
  ASSERT_EQ(sender.wire.open_window(0).opcode(), Opcode::window_opened);
  const auto subscription = receiver.subscription("/t");
  const std::uint64_t creation = receiver.wire.last_request();
  receiver.lose_connection();
  receiver.come_back();
  const auto packets = receiver.wire.drain();
  EXPECT_EQ(order_of(packets), "own announce region ");
  const auto own = of_kind<wire::Own>(packets, Opcode::own);
  ASSERT_EQ(own.size(), 1u);
  EXPECT_EQ(own[0].kind, Kind::subscription);
  EXPECT_EQ(own[0].topic, subscription.topic);
  EXPECT_EQ(own[0].index, subscription.index);
  EXPECT_EQ(own[0].generation, subscription.generation);
  EXPECT_EQ(own[0].creation, creation);
  EXPECT_EQ(own[0].active, 1u);
  const auto announced = of_kind<wire::Announcement>(packets, Opcode::announce);
  ASSERT_EQ(announced.size(), 1u);
  EXPECT_EQ(announced[0].generation, publisher.generation);
  EXPECT_EQ(announced[0].own_generation, subscription.generation);
  EXPECT_EQ(announced[0].from_start, 0u) << "the publisher was there first";
  EXPECT_EQ(announced[0].window_count, 1u);
  EXPECT_EQ(packets[1].fds.size(), 2u) << "region and window";
  const auto regions = of_kind<wire::Reference>(packets, Opcode::region);
  ASSERT_EQ(regions.size(), 1u);
  EXPECT_EQ(regions[0].index, sender.welcome.client);
  EXPECT_EQ(regions[0].generation, sender.welcome.client_generation);

  // The other side.
  sender.wire.drain();
  sender.lose_connection();
  sender.come_back();
  const auto to_sender = sender.wire.drain();
  EXPECT_EQ(order_of(to_sender), "own announce region ");
  EXPECT_EQ(of_kind<wire::Announcement>(to_sender, Opcode::announce)[0].generation,
            subscription.generation);
  EXPECT_EQ(to_sender[1].fds.size(), 3u) << "region and two doorbells";
}

TEST(DaemonRejoin, DoorbellsWhoseNamesWereRemovedAreRecreated) {
  DaemonProcess daemon;
  Node sender(daemon), receiver(daemon);
  sender.publisher("/t");
  receiver.subscription("/t");
  const UniqueFd eventfd(::dup(receiver.doorbells[0].get()));
  sender.lose_connection();
  receiver.lose_connection();
  for (const auto& name : std::filesystem::directory_iterator(daemon.socket_path() + ".bells"))
    std::filesystem::remove(name);
  ASSERT_TRUE(daemon.wait_for_next(daemon.kill_worker()));
  sender.come_back();
  const auto first = of_kind<wire::Announcement>(sender.wire.drain(), Opcode::announce);
  ASSERT_EQ(first.size(), 1u);
  EXPECT_EQ(first[0].doorbell_count, 2u) << "the eventfd was kept";

  receiver.come_back();
  auto packets = receiver.wire.drain();
  ASSERT_FALSE(packets.empty());
  ASSERT_EQ(packets[0].opcode(), Opcode::doorbells_renewed);
  EXPECT_EQ(packets[0].as<wire::DoorbellsRenewed>().wait_set, 0u);
  ASSERT_EQ(packets[0].fds.size(), 2u);
  DoorbellReceiver doorbells(std::move(packets[0].fds[0]), std::move(packets[0].fds[1]));
  // The daemon repeats it to its publishers, which ring the new socket.
  std::vector<UniqueFd> fds;
  const auto again = sender.wire.expect<wire::Announcement>(Opcode::announce, &fds);
  EXPECT_EQ(again.generation, first[0].generation);
  ASSERT_EQ(fds.size(), 3u);
  std::uint64_t before = 0, after = 0;
  ASSERT_EQ(::read(eventfd.get(), &before, sizeof before) >= 0 || errno == EAGAIN, true);
  EXPECT_EQ(Doorbell(UniqueFd(::dup(fds[2].get()))).ring(), Doorbell::Rung::rung);
  pollfd readable{doorbells.datagram_fd(), POLLIN, 0};
  EXPECT_EQ(::poll(&readable, 1, WireClient::patience_ms), 1);
  EXPECT_EQ(Doorbell(std::move(fds[2]), std::move(fds[1])).ring(), Doorbell::Rung::rung);
  EXPECT_EQ(::read(eventfd.get(), &after, sizeof after), static_cast<ssize_t>(sizeof after))
      << "it is the same eventfd";

  // No further packet is lost.
  receiver.lose_connection();
  receiver.come_back();
  EXPECT_EQ(order_of(receiver.wire.drain()), "own announce region ");
}

TEST(DaemonRejoin, AClientThatDropsNewDoorbellsGetsThemThreeTimes) {
  DaemonProcess daemon;
  Node sender(daemon), receiver(daemon);
  sender.publisher("/t");
  receiver.subscription("/t");
  receiver.doorbells.clear();
  receiver.lose_connection();
  receiver.come_back();
  EXPECT_EQ(order_of(receiver.wire.drain()), "own announce region ") << "it already had them";
  ASSERT_TRUE(daemon.wait_for_next(daemon.kill_worker()));
  for (const char* expected : {"212 own announce region ", "212 own announce region ",
                               "212 own announce region ", "own announce region "}) {
    receiver.lose_connection();
    receiver.come_back();
    EXPECT_EQ(order_of(receiver.wire.drain()), expected);
  }
}

TEST(DaemonRejoin, TheNewConnectionTakesThePlaceOfTheOldOne) {
  // Places for two processes, and for one observer: rejoining connections need no more.
  DaemonProcess daemon({.config = "[quota]\nclients = 2\n[heap]\nwindow_bytes = \"64MiB\"\n"});
  Node node(daemon), other(daemon);
  node.subscription("/t");
  // both loops together: a process's reconnections at once
  constexpr int times = 9;
  for (int i = 0; i < times; ++i) {
    PacketSocket before(node.wire.socket().release());
    node.come_back();  // before the daemon can know that the old connection is dead
    std::array<std::byte, wire::packet_bytes_max> buffer;
    Result<Packet> packet = before.receive(buffer, Wait::yes);
    while (packet && packet->kind == Packet::Kind::data) packet = before.receive(buffer, Wait::yes);
    EXPECT_TRUE(packet && packet->kind == Packet::Kind::end) << "the old connection has ended";
  }
  for (int i = 0; i < times; ++i) {
    node.lose_connection();
    other.lose_connection();
    node.come_back();
    other.come_back();
  }
  other.publisher("/t");
  EXPECT_EQ(of_kind<wire::Announcement>(node.wire.drain(), Opcode::announce).size(), 1u);
  WireClient third(daemon.socket_path());
  EXPECT_EQ(third.hello().refused_code(), Errc::quota_exceeded);
}

TEST(DaemonRejoin, AProcessThatSendsHelloAgainHasOnePlace) {
  DaemonProcess daemon({.config = "[quota]\nclients = 1\n[heap]\nwindow_bytes = \"64MiB\"\n",
                        .arguments = {"--log-level", "debug"}});
  Node first(daemon);
  first.lose_connection();
  ASSERT_TRUE(daemon.wait_for_log("connection closed"));
  EXPECT_EQ(WireClient(daemon.socket_path()).hello().refused_code(), Errc::quota_exceeded)
      << "the first one still has its region";
  first.region = Mapping();
  // After a look at the process that took long, agnocastd rests before the next one.
  Incoming answer;
  ASSERT_TRUE(soon([&] {
    WireClient again(daemon.socket_path());
    answer = again.hello();
    return answer.refused_code() != Errc::quota_exceeded;
  }));
  ASSERT_EQ(answer.opcode(), Opcode::welcome) << answer.refused_text();
  const auto again = answer.as<wire::Welcome>();
  EXPECT_EQ(again.client, first.welcome.client);
  EXPECT_NE(again.client_generation, first.welcome.client_generation);
}

TEST(DaemonRejoin, NoOtherProcessRejoinsInItsPlace) {
  DaemonProcess daemon;
  Node node(daemon);
  node.subscription("/t");
  const auto refused = [&](wire::Welcome claimed, std::uint64_t fingerprint = abi::fingerprint()) {
    WireClient client(daemon.socket_path());
    return client.rejoin(claimed, fingerprint).refused_code();
  };
  wire::Welcome claimed = node.welcome;
  EXPECT_EQ(refused(claimed, abi::fingerprint() ^ 1), Errc::layout_mismatch);
  ++claimed.incarnation;
  EXPECT_EQ(refused(claimed), Errc::started_anew);
  claimed = node.welcome;
  ++claimed.client_generation;
  EXPECT_EQ(refused(claimed), Errc::started_anew);
  claimed = node.welcome;
  claimed.client = 1000;
  EXPECT_EQ(refused(claimed), Errc::started_anew) << "a place that was never used";
  claimed.client = abi::client_count_max;
  EXPECT_EQ(refused(claimed), Errc::protocol_violation);
  const pid_t child = ::fork();
  if (child == 0) {
    WireClient client(daemon.socket_path());
    ::_exit(static_cast<int>(client.rejoin(node.welcome).refused_code()));
  }
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_EQ(WEXITSTATUS(status), static_cast<int>(Errc::permission_denied));
  EXPECT_EQ(node.wire.open_window(0).opcode(), Opcode::window_opened) << "nothing has changed";
}

TEST(DaemonRejoin, EndpointsCreatedMeanwhileAreAnnounced) {
  DaemonProcess daemon;
  Node node(daemon), other(daemon);
  node.subscription("/a");
  node.publisher("/b");
  node.lose_connection();
  const auto publisher = other.publisher("/a");
  const auto subscription = other.subscription("/b");
  node.come_back();
  const auto announced = of_kind<wire::Announcement>(node.wire.drain(), Opcode::announce);
  ASSERT_EQ(announced.size(), 2u);
  EXPECT_EQ(announced[0].generation, publisher.generation);
  EXPECT_EQ(announced[0].from_start, 1u);
  EXPECT_EQ(announced[1].generation, subscription.generation);
}

TEST(DaemonRejoin, NoticesSentMeanwhileArriveOnce) {
  DaemonProcess daemon;
  Node node(daemon), other(daemon);
  Qos best_effort = reliable;
  best_effort.reliable = false;
  ASSERT_EQ(node.wire.create_publisher("/a", best_effort).opcode(), Opcode::endpoint_created);
  node.lose_connection();
  ASSERT_TRUE(eventually([&] {
    const auto processes = wire_dump(daemon.socket_path()).processes;
    return std::any_of(processes.begin(), processes.end(), [](const wire::DumpProcess& process) {
      return process.state == wire::ProcessState::orphaned;
    });
  }));
  other.subscription("/a");
  for (const std::size_t count : {1u, 0u}) {
    node.come_back();
    const auto told = of_kind<wire::Notice>(node.wire.drain(), Opcode::notice);
    ASSERT_EQ(told.size(), count);
    for (const wire::Notice& notice : told)
      EXPECT_EQ(notice.code, static_cast<std::uint32_t>(Errc::qos_incompatible));
    node.lose_connection();
  }
}

TEST(DaemonRejoin, TheLastMessagesOfTheDeadAreAnnounced) {
  DaemonProcess daemon;
  Node node(daemon);
  const auto subscription = node.subscription("/t");
  auto other = std::make_unique<Node>(daemon);
  const auto known = other->publisher("/t");
  ASSERT_EQ(of_kind<wire::Announcement>(node.wire.drain(), Opcode::announce).size(), 1u);
  node.lose_connection();
  auto third = std::make_unique<Node>(daemon);  // came and went while the process was away
  ASSERT_EQ(third->wire.open_window(0).opcode(), Opcode::window_opened);
  const auto unknown = third->publisher("/t");
  const region::PublisherWords<SharedMemory> words{third->region.base(), unknown.extent};
  words.head().store(abi::pack_entry(unknown.first_sequence + 5, 3));
  third->lose_connection();
  third->region = Mapping();  // the daemon treats the process as ended
  other->lose_connection();
  other->region = Mapping();
  ASSERT_TRUE(daemon.wait_for_log("client gone client=1"));
  ASSERT_TRUE(daemon.wait_for_log("client gone client=2"));
  node.come_back();
  const auto packets = node.wire.drain();
  EXPECT_EQ(order_of(packets), "own announce announce orphaned orphaned region region ");
  const auto announced = of_kind<wire::Announcement>(packets, Opcode::announce);
  EXPECT_EQ(announced.at(0).generation, known.generation);
  EXPECT_EQ(announced.at(1).generation, unknown.generation);
  EXPECT_EQ(announced.at(1).own_generation, subscription.generation);
  EXPECT_EQ(announced.at(1).window_count, 1u);
  ASSERT_EQ(packets[2].fds.size(), 2u) << "region and window of the dead process";
  EXPECT_TRUE(Mapping::map(packets[2].fds[0].get(), abi::page_bytes, Mapping::Access::read));
  const auto orphaned = of_kind<wire::Orphaned>(packets, Opcode::orphaned);
  EXPECT_EQ(orphaned.at(1).generation, unknown.generation);
  EXPECT_EQ(abi::sequence_of(orphaned.at(1).final_head), unknown.first_sequence + 5);

  // A subscription that joins now gets none of them, neither now nor on the next connection.
  node.subscription("/t");
  node.lose_connection();
  node.come_back();
  EXPECT_EQ(of_kind<wire::Announcement>(node.wire.drain(), Opcode::announce).size(), 2u);

  // Its places and descriptors are reused after the acknowledged unmap.
  const std::size_t descriptors = daemon.descriptor_count();
  for (const auto& made : {known, unknown})
    node.wire.unlinked(Kind::publisher, made.topic, made.index, made.generation);
  for (const auto* dead : {other.get(), third.get()})
    node.wire.unlinked(Kind::region, 0, dead->welcome.client, dead->welcome.client_generation);
  node.wire.drain();
  EXPECT_TRUE(eventually([&] { return daemon.descriptor_count() < descriptors; }))
      << "they are closed outside the daemon's loop";
  EXPECT_EQ(Node(daemon).publisher("/t").index, known.index);
}

TEST(DaemonRejoin, EndedEndpointsAreForgottenAndLeavingOnesAnnounced) {
  DaemonProcess daemon;
  Node node(daemon), other(daemon);
  const auto publisher = node.publisher("/t");
  const auto leaving = other.subscription("/t");
  const auto over = other.subscription("/t");
  ASSERT_EQ(of_kind<wire::Announcement>(node.wire.drain(), Opcode::announce).size(), 2u);
  node.lose_connection();
  for (const auto& made : {leaving, over}) {
    EXPECT_EQ(
        other.wire
            .reference(Opcode::leave, Kind::subscription, made.topic, made.index, made.generation)
            .opcode(),
        Opcode::done);
  }
  EXPECT_EQ(
      other.wire
          .reference(Opcode::drained, Kind::subscription, over.topic, over.index, over.generation)
          .opcode(),
      Opcode::done);
  node.come_back();
  const auto packets = node.wire.drain();
  EXPECT_EQ(order_of(packets), "own announce forget region ");
  EXPECT_EQ(of_kind<wire::Announcement>(packets, Opcode::announce).at(0).generation,
            leaving.generation);
  EXPECT_EQ(of_kind<wire::Reference>(packets, Opcode::forget).at(0).generation, over.generation);
  // Sent on every new connection until it is unlinked.
  node.lose_connection();
  node.come_back();
  EXPECT_EQ(order_of(node.wire.drain()), "own announce forget region ");
  node.wire.unlinked(Kind::subscription, over.topic, over.index, over.generation);
  node.lose_connection();
  node.come_back();
  const auto last = node.wire.drain();
  EXPECT_EQ(order_of(last), "own announce region ");
  EXPECT_EQ(of_kind<wire::Own>(last, Opcode::own).at(0).generation, publisher.generation);
}

TEST(DaemonRejoin, AnUnlinkedRegionIsIgnoredBeforeAllPacketsWereRead) {
  DaemonProcess daemon;
  Node node(daemon);
  node.publisher("/t");
  auto other = std::make_unique<Node>(daemon);
  const auto subscription = other->subscription("/t");
  node.wire.drain();
  node.lose_connection();
  other->lose_connection();
  other->region = Mapping();  // the daemon treats the process as ended
  ASSERT_TRUE(daemon.wait_for_log("client gone client=1"));
  node.come_back();
  const auto unmap_region = [&] {
    node.wire.unlinked(Kind::region, 0, other->welcome.client, other->welcome.client_generation);
  };
  unmap_region();  // it has read nothing but `rejoined`
  EXPECT_EQ(order_of(node.wire.drain()), "own forget region ") << "nothing was refused";
  node.wire.unlinked(Kind::subscription, subscription.topic, subscription.index,
                     subscription.generation);
  unmap_region();
  EXPECT_EQ(order_of(node.wire.drain()), "") << "nothing was refused";
  EXPECT_EQ(Node(daemon).welcome.client, other->welcome.client) << "its place is free";
}

TEST(DaemonRejoin, APublisherThatWasNotDrainedKeepsNoRegionTaken) {
  DaemonProcess daemon;
  Node node(daemon);
  const auto publisher = node.publisher("/t");
  auto other = std::make_unique<Node>(daemon);
  other->subscription("/t");
  node.wire.drain();
  EXPECT_EQ(node.wire
                .reference(Opcode::leave, Kind::publisher, publisher.topic, publisher.index,
                           publisher.generation)
                .opcode(),
            Opcode::done);
  other->wire.drain();
  other->wire.unlinked(Kind::publisher, publisher.topic, publisher.index, publisher.generation);
  other->wire.drain();
  // Its index is free on the board; it was about to send `drained`, and had unmapped everything.
  node.lose_connection();
  node.come_back();
  const auto packets = node.wire.drain();
  EXPECT_EQ(order_of(packets), "own forget region ");
  const auto forgotten = of_kind<wire::Reference>(packets, Opcode::forget).at(0);
  node.wire.unlinked(Kind::subscription, forgotten.topic, forgotten.index, forgotten.generation);
  node.wire.unlinked(Kind::region, 0, other->welcome.client, other->welcome.client_generation);
  EXPECT_EQ(order_of(node.wire.drain()), "") << "nothing was refused";
}

TEST(DaemonRejoin, AWindowOpenedMeanwhileComesWithTheAnnouncement) {
  DaemonProcess daemon;
  Node node(daemon), other(daemon);
  other.publisher("/t");
  ASSERT_EQ(other.wire.open_window(0).opcode(), Opcode::window_opened);
  node.subscription("/t");
  node.lose_connection();
  ASSERT_EQ(other.wire.open_window(1).opcode(), Opcode::window_opened);
  node.come_back();
  const auto packets = node.wire.drain();
  EXPECT_EQ(of_kind<wire::Announcement>(packets, Opcode::announce).at(0).window_count, 2u);
  EXPECT_EQ(packets.at(1).fds.size(), 3u);
}

TEST(DaemonRejoin, ARepeatedRequestIsCarriedOutOnce) {
  DaemonProcess daemon;
  Node node(daemon), other(daemon);
  const auto theirs = other.publisher("/t");
  const auto first = node.subscription("/t");
  const std::uint64_t creation = node.wire.last_request();
  const auto subscription_body = WireClient::endpoint("/t", reliable);
  const auto publisher = node.publisher("/u");
  const std::uint64_t publisher_creation = node.wire.last_request();
  node.lose_connection();
  node.come_back();
  node.wire.drain();
  const auto again =
      Node::made(node.wire.ask_again(Opcode::create_subscription, subscription_body, creation));
  EXPECT_EQ(again.generation, first.generation);
  EXPECT_EQ(again.extent, first.extent);
  const auto announced = of_kind<wire::Announcement>(node.wire.drain(), Opcode::announce);
  ASSERT_EQ(announced.size(), 1u) << "earlier it could not know the recipient";
  EXPECT_EQ(announced[0].generation, theirs.generation);
  const auto same = Node::made(node.wire.ask_again(
      Opcode::create_publisher, WireClient::endpoint("/u", reliable), publisher_creation));
  EXPECT_EQ(same.generation, publisher.generation);
  EXPECT_EQ(same.first_sequence, publisher.first_sequence);
  EXPECT_EQ(same.slot_count, publisher.slot_count);
  const auto never_heard = Node::made(
      node.wire.ask_again(Opcode::create_publisher, WireClient::endpoint("/u", reliable), 1000));
  EXPECT_NE(never_heard.generation, publisher.generation);
  EXPECT_EQ(never_heard.index, publisher.index + 1) << "the first request did not arrive";

  wire::WaitSetRequest executor{};
  EXPECT_EQ(node.wire.ask_again(Opcode::open_wait_set, executor, 1001).refused_code(),
            Errc::protocol_violation)
      << "a subscription uses that executor";
  executor.wait_set = 1;
  ASSERT_EQ(node.wire.open_wait_set(1).opcode(), Opcode::wait_set_opened);
  const std::uint64_t opening = node.wire.last_request();
  EXPECT_EQ(node.wire.open_wait_set(1).refused_code(), Errc::protocol_violation);
  EXPECT_EQ(node.wire.ask_again(Opcode::open_wait_set, executor, opening).fds.size(), 2u);

  const auto reference = [](Kind kind, const wire::EndpointCreated& made) {
    wire::Reference body{};
    body.kind = kind;
    body.topic = made.topic;
    body.index = made.index;
    body.generation = made.generation;
    return body;
  };
  const auto subscription = reference(Kind::subscription, first);
  EXPECT_EQ(node.wire.ask_again(Opcode::drained, subscription, 1002).refused_code(),
            Errc::protocol_violation)
      << "it has not left";
  for (const Opcode opcode : {Opcode::leave, Opcode::drained}) {
    EXPECT_EQ(node.wire.ask(opcode, subscription).opcode(), Opcode::done);
    EXPECT_EQ(node.wire.ask_again(opcode, subscription, node.wire.last_request()).opcode(),
              Opcode::done);
    EXPECT_EQ(node.wire.ask(opcode, subscription).refused_code(), Errc::protocol_violation);
  }
  EXPECT_EQ(node.wire.ask_again(Opcode::leave, reference(Kind::publisher, theirs), 1003).opcode(),
            Opcode::done)
      << "no endpoint of others is left here";
  EXPECT_EQ(abi::state_of(
                region::TopicWords<SharedMemory>{node.board.base(), abi::topic_offset(theirs.topic)}
                    .publisher(theirs.index, offsetof(abi::PublisherEntry, word))
                    .load()),
            abi::BoardState::active);
}

}  // namespace
}  // namespace agnocast::test
