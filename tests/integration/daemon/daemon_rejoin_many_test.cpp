// SPDX-License-Identifier: Apache-2.0
//
// Goal: a rejoining process for which the daemon has more packets than a connection may have
// waiting for a client that does not read gets all of them as it reads; while it reads nothing it
// delays nobody.
// Method: a raw client whose publishers have tens of thousands of subscriptions, those of living
// processes or of dead ones.

#include <daemon/transport/session.hpp>
#include <tests/integration/daemon/raw_node.hpp>

#include <memory>
#include <vector>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

constexpr std::size_t publisher_count = 11;
constexpr std::size_t peer_count = publisher_count * abi::subscription_count_max;
static_assert(peer_count > daemon::Session::queue_count_max + 4096, "and what the socket takes");

const char* const all_places = "[quota]\nsubscriptions_per_topic = \"unlimited\"\n";

void read_all(RawNode& node) {
  while (node.wire.poll()) {
  }
}

/// 11 publishers of one topic, and as many subscriptions as a topic can have.
void fill_one_topic(RawNode& publisher, RawNode& subscriber) {
  for (std::size_t p = 0; p < publisher_count; ++p) publisher.publisher("/wide");
  for (std::size_t s = 0; s < abi::subscription_count_max; ++s) {
    subscriber.subscription("/wide");
    read_all(subscriber);
    read_all(publisher);
  }
}

void lose_connection(RawNode& node) { node.wire.socket().close(); }

void come_back(RawNode& node, const DaemonProcess& daemon) {
  node.wire.connect_again(daemon.socket_path());
  const Incoming answer = node.wire.rejoin(node.welcome);
  ASSERT_EQ(answer.opcode(), Opcode::rejoined) << answer.refused_text();
}

wire::Unlinked unlinked(Kind kind, std::uint32_t topic, std::uint64_t index,
                        std::uint64_t generation, std::uint64_t seen) {
  wire::Unlinked body{};
  body.kind = kind;
  body.topic = topic;
  body.index = index;
  body.generation = generation;
  body.seen = seen;
  return body;
}

TEST(DaemonRejoinMany, LivingPeersAreAnnouncedAsTheProcessReads) {
  DaemonProcess daemon({.more_config = all_places});
  RawNode sender(daemon), many(daemon), corner(daemon);
  sender.publisher("/first");
  const auto first = corner.subscription("/first");
  fill_one_topic(sender, many);
  sender.publisher("/last");
  read_all(sender);
  lose_connection(sender);
  corner.subscription("/last");
  come_back(sender, daemon);

  std::size_t owned = 0, announced = 0, regions = 0;
  Incoming packet = sender.wire.next();
  for (; packet.opcode() == Opcode::own; packet = sender.wire.next()) ++owned;
  ASSERT_EQ(packet.opcode(), Opcode::announce);
  ASSERT_EQ(packet.as<wire::Announcement>().generation, first.generation);
  // It acknowledges all that it knows of this process now; but more will come.
  const std::uint64_t seen = sender.wire.seen();
  sender.wire.send(Opcode::unlinked,
                   unlinked(Kind::subscription, first.topic, first.index, first.generation, seen));
  sender.wire.send(Opcode::unlinked, unlinked(Kind::region, 0, corner.welcome.client,
                                              corner.welcome.client_generation, seen));
  for (; packet.opcode() == Opcode::announce; packet = sender.wire.next()) ++announced;
  EXPECT_EQ(packet.refused_text(), "");
  for (; packet.opcode() == Opcode::region; packet = sender.wire.next()) {
    if (++regions == 2) break;
  }
  EXPECT_EQ(owned, publisher_count + 2);
  EXPECT_EQ(announced, peer_count + 2);
  EXPECT_EQ(regions, 2u);
  EXPECT_TRUE(sender.wire.drain().empty());
}

TEST(DaemonRejoinMany, DeadPeersAreAnnouncedAsTheProcessReads) {
  constexpr std::size_t topics = 9, topics_of_one = 2;
  constexpr std::size_t dead_count = topics * abi::subscription_count_max;
  static_assert(dead_count > daemon::Session::queue_count_max + 500, "small packets");
  DaemonProcess daemon({.more_config = all_places, .arguments = {"--log-level", "debug"}});
  RawNode sender(daemon);
  std::vector<std::unique_ptr<RawNode>> dead;
  for (std::size_t t = 0; t < topics; ++t) {
    const std::string topic = "/wide" + std::to_string(t);
    sender.publisher(topic);
    if (t % topics_of_one == 0) dead.push_back(std::make_unique<RawNode>(daemon));
    for (std::size_t s = 0; s < abi::subscription_count_max; ++s) {
      dead.back()->subscription(topic);
      read_all(*dead.back());
      read_all(sender);
    }
  }
  lose_connection(sender);
  const std::size_t processes = dead.size();
  dead.clear();
  for (std::size_t client = 1; client <= processes; ++client)
    ASSERT_TRUE(daemon.wait_for_log("client gone client=" + std::to_string(client)));
  come_back(sender, daemon);
  std::size_t forgotten = 0, regions = 0;
  Incoming packet = sender.wire.next();
  while (packet.opcode() == Opcode::own) packet = sender.wire.next();
  for (; packet.opcode() == Opcode::forget; packet = sender.wire.next()) ++forgotten;
  for (; packet.opcode() == Opcode::region; packet = sender.wire.next()) {
    if (++regions == processes) break;
  }
  EXPECT_EQ(forgotten, dead_count);
  EXPECT_EQ(regions, processes);
  EXPECT_TRUE(sender.wire.drain().empty());
}

/// In its own process; returns whether it was admitted.
bool publishes_and_ends(const DaemonProcess& daemon) {
  const pid_t pid = ::fork();
  if (pid == 0) {
    WireClient wire(daemon.socket_path());
    const bool admitted =
        wire.hello().opcode() == Opcode::welcome &&
        wire.create_publisher("/small", reliable).opcode() == Opcode::endpoint_created;
    ::_exit(admitted ? 0 : 1);
  }
  int status = 0;
  ::waitpid(pid, &status, 0);
  return WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

// It is stopped: packets wait for it, and still it does not keep the places of others.
TEST(DaemonRejoinMany, AProcessThatReadsNothingIsRevokedLikeAnyOther) {
  DaemonProcess daemon({.config = "[limits]\npublishers_per_topic = 11\n"
                                  "[quota]\npublishers_per_topic = \"unlimited\"\n"
                                  "subscriptions_per_topic = \"unlimited\"\n"});
  RawNode sender(daemon), many(daemon);
  fill_one_topic(sender, many);
  sender.subscription("/small");
  read_all(sender);
  lose_connection(sender);
  come_back(sender, daemon);
  std::size_t lives = 0;
  EXPECT_TRUE(eventually([&] {
    if (publishes_and_ends(daemon)) ++lives;
    return lives > 2 * publisher_count;
  }));
  EXPECT_TRUE(daemon.wait_for_log("client revoked"));
}

}  // namespace
}  // namespace agnocast::test
