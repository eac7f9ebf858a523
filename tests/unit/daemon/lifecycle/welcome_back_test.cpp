// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process that is back is sent all that its announce sets say, once and in order, however
// little it reads at a time and whatever ends meanwhile. Method: the class over the daemon's core;
// connections that keep each packet. A connection of a crowded user gets one packet more each time
// when the test has read the one before, so everything can end between two packets.

#include <daemon/lifecycle/welcome_back.hpp>
#include <tests/unit/daemon/lifecycle/lifecycle_fixture.hpp>

#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <vector>

namespace agnocast::daemon {
namespace {

using wire::Opcode;

class WelcomeBackTest : public LifecycleTest {
 protected:
  WelcomeBackTest() { core.channel.keeps_output = true; }

  /// Reads what is there, and gives the daemon one occasion to send more.
  void read(Session& session) {
    session.drop_output();
    welcome_back.go_on();
  }
  void read_all(ClientIndex client, Session& session) {
    for (int packets = 0; welcome_back.is_announcing(client); ++packets) {
      read(session);
      ASSERT_LT(packets, 1000);
    }
  }
  /// Ends a subscription that no publisher knows.
  void end(const EndpointRef& subscription) {
    registry.change_subscription(subscription.topic, subscription.index, EndpointState::dead);
    registry.free_subscription(subscription.topic, subscription.index);
  }
  std::vector<EndpointRef> own_endpoints_sent() const {
    std::vector<EndpointRef> found;
    for (const auto& packet : all<wire::Own>(Opcode::own)) found.push_back(place_in(packet));
    return found;
  }

  Endings endings{core.registry};
  Announcing announcing{core.registry, endings};
  Announcer announcer{core.registry, core.regions, core.doorbells, core.channel};
  EffectRunner runner{core.registry, endings, announcer, core.doorbells, core.channel};
  WelcomeBack welcome_back{core.registry, announcing, announcer, runner, core.channel};
};

TEST_F(WelcomeBackTest, SendsItsEndpointsThenTheirPeersThenWhatIsOverThenRegionsThenNotices) {
  const ClientIndex reader = core.process(1), writer = core.process(1), past = core.process(1);
  const ClientIndex back = core.process(1);
  const EndpointRef publisher = add(back, Kind::publisher, "/out");
  const EndpointRef subscription = add(back, Kind::subscription, "/in");
  const EndpointRef leaves = add(back, Kind::subscription, "/left");
  const EndpointRef follower = add(reader, Kind::subscription, "/out");
  const EndpointRef orphan = add(writer, Kind::publisher, "/in");
  const EndpointRef active = add(writer, Kind::publisher, "/in");
  const EndpointRef unmapped = add(past, Kind::publisher, "/in");
  registry.change_subscription(leaves.topic, leaves.index, EndpointState::leaving);
  for (const EndpointRef& ref : {orphan, unmapped})
    registry.orphan_publisher(ref.topic, ref.index, 0);
  registry.acknowledge_unmap(unmapped, back);  // and not its region
  announcer.notice(publisher, Errc::qos_incompatible, "it was away");
  connect(back);
  welcome_back.begin(back);
  EXPECT_FALSE(welcome_back.is_announcing());
  ASSERT_EQ(lines(), (std::vector<Line>{{back, Opcode::own},
                                        {back, Opcode::own},
                                        {back, Opcode::own},
                                        {back, Opcode::announce},
                                        {back, Opcode::announce},
                                        {back, Opcode::announce},
                                        {back, Opcode::orphaned},
                                        {back, Opcode::region},
                                        {back, Opcode::region},
                                        {back, Opcode::region},
                                        {back, Opcode::notice}}));
  EXPECT_EQ(own_endpoints_sent(), (std::vector{publisher, subscription, leaves}));
  const auto own = all<wire::Own>(Opcode::own);
  EXPECT_EQ(own[1].active, 1u);
  EXPECT_EQ(own[2].active, 0u);
  EXPECT_EQ(own[2].creation, registry.subscription(leaves.topic, leaves.index).creation);
  const auto peers = all<wire::Announcement>(Opcode::announce);
  EXPECT_EQ(place_in(peers[0]), follower);
  EXPECT_EQ(place_in(peers[1]), orphan) << "it is read to its end";
  EXPECT_EQ(place_in(peers[2]), active);
  std::vector<std::uint64_t> regions;
  for (const auto& packet : all<wire::Reference>(Opcode::region)) regions.push_back(packet.index);
  EXPECT_EQ(regions, (std::vector<std::uint64_t>{number(reader), number(writer), number(past)}));
}

TEST_F(WelcomeBackTest, ATopicWithSeveralEndpointsOfTheProcessIsLookedAtOnce) {
  const ClientIndex owner = core.process(1), back = core.process(1);
  for (int i = 0; i < 3; ++i) add(back, Kind::subscription);
  const EndpointRef publisher = add(owner, Kind::publisher);
  registry.orphan_publisher(publisher.topic, publisher.index, 0);
  connect(back);
  welcome_back.begin(back);
  EXPECT_EQ(all<wire::Orphaned>(Opcode::orphaned).size(), 1u);
}

TEST_F(WelcomeBackTest, StopsAtHalfAQueueUntilTheProcessReads) {
  const ClientIndex back = core.process(1);
  for (const char* const topic : {"/a", "/b", "/c"}) add(back, Kind::subscription, topic);
  Session& session = connect(back);
  for (std::size_t i = 0; i < Session::queue_count_max / 2 - 2; ++i) session.push({}, {});
  welcome_back.begin(back);
  EXPECT_EQ(sent.size(), 2u);
  EXPECT_TRUE(welcome_back.is_announcing(back));
  welcome_back.go_on();
  EXPECT_EQ(sent.size(), 2u) << "it has read nothing";
  read(session);
  EXPECT_EQ(sent.size(), 3u);
  EXPECT_FALSE(welcome_back.is_announcing());
}

TEST_F(WelcomeBackTest, SendsTheSameToAProcessOfACrowdedUserOnePacketAtATime) {
  const ClientIndex owner = core.process(1), back = core.process(1);
  add(back, Kind::subscription);
  add(back, Kind::publisher, "/other");
  add(owner, Kind::publisher);
  add(owner, Kind::subscription, "/other");
  connect(back);
  welcome_back.begin(back);
  std::vector<std::vector<std::byte>> at_once;
  for (const Sent& one : sent) at_once.push_back(one.packet.bytes);
  ASSERT_EQ(at_once.size(), 5u);

  sent.clear();
  Session& session = connect_slowly(back);
  welcome_back.begin(back);
  EXPECT_EQ(sent.size(), 1u) << "it has no packet to read, so it gets one";
  welcome_back.go_on();
  EXPECT_EQ(sent.size(), 1u);
  for (std::size_t count = 2; count <= at_once.size(); ++count) {
    read(session);
    EXPECT_EQ(sent.size(), count);
  }
  read_all(back, session);
  ASSERT_EQ(sent.size(), at_once.size());
  for (std::size_t i = 0; i < at_once.size(); ++i) EXPECT_EQ(sent[i].packet.bytes, at_once[i]);
}

TEST_F(WelcomeBackTest, AProcessThatDoesNotReadDelaysNoOther) {
  const ClientIndex deaf = core.process(1), back = core.process(2);
  for (const ClientIndex client : {deaf, back}) {
    add(client, Kind::subscription);
    add(client, Kind::subscription);
  }
  connect_slowly(deaf);
  Session& session = connect_slowly(back);
  welcome_back.begin(deaf);
  welcome_back.begin(back);
  read_all(back, session);
  EXPECT_EQ(count_to(back), 2u);
  EXPECT_EQ(count_to(deaf), 1u);
  EXPECT_TRUE(welcome_back.is_announcing(deaf));
}

TEST_F(WelcomeBackTest, SkipsAnEndpointThatEndedMeanwhileAndTheNextOneInItsPlace) {
  const ClientIndex owner = core.process(1), back = core.process(1), other = core.process(2);
  const EndpointRef first = add(back, Kind::subscription, "/first");
  const EndpointRef ends = add(back, Kind::subscription, "/ends");
  const EndpointRef ends_later = add(back, Kind::subscription, "/ends_later");
  Session& session = connect_slowly(back);
  connect(other);
  welcome_back.begin(back);
  const auto replace = [&](const EndpointRef& ref, const std::string& topic) {
    end(ref);
    ASSERT_EQ(add(other, Kind::subscription, topic), ref);
    add(owner, Kind::publisher, topic);  // a peer of the new one
  };
  replace(ends, "/ends");
  read(session);
  EXPECT_EQ(own_endpoints_sent(), (std::vector{first, ends_later}));
  replace(ends_later, "/ends_later");
  const std::size_t before = count_to(other);
  read_all(back, session);
  EXPECT_EQ(count_to(back), 2u);
  EXPECT_EQ(count_to(other), before) << "nothing is announced to the owner of the next one";
}

TEST_F(WelcomeBackTest, AnnouncesAPeerThatJoinedMeanwhileAndNoneThatEnded) {
  const ClientIndex owner = core.process(1), back = core.process(1);
  const EndpointRef subscription = add(back, Kind::subscription);
  const EndpointRef ends = add(owner, Kind::publisher);
  Session& session = connect_slowly(back);
  welcome_back.begin(back);
  registry.orphan_publisher(ends.topic, ends.index, 0);
  registry.acknowledge_unmap(ends, back);
  registry.end_publisher(ends.topic, ends.index, EndpointState::over);
  const EndpointRef joins = add(owner, Kind::publisher);
  ASSERT_NE(joins, ends);
  sent.clear();
  read_all(back, session);
  const auto peers = all<wire::Announcement>(Opcode::announce);
  ASSERT_EQ(peers.size(), 1u);
  EXPECT_EQ(place_in(peers[0]), joins);
  EXPECT_TRUE(all<wire::Orphaned>(Opcode::orphaned).empty());
  EXPECT_TRUE(is_notified(joins, registry.owner_of(subscription)));
}

TEST_F(WelcomeBackTest, WithoutAConnectionTheRestIsDroppedAndEverythingBeginsAnew) {
  const ClientIndex back = core.process(1);
  const EndpointRef first = add(back, Kind::subscription), second = add(back, Kind::subscription);
  connect_slowly(back);
  welcome_back.begin(back);
  core.channel.begin_anew(back, "lost");
  welcome_back.go_on();
  EXPECT_FALSE(welcome_back.is_announcing());
  connect(back);
  welcome_back.go_on();
  EXPECT_EQ(sent.size(), 1u) << "a new connection does not continue the former one";
  sent.clear();
  welcome_back.begin(back);
  EXPECT_EQ(own_endpoints_sent(), (std::vector{first, second}));
}

// A statement about a region counts only after the last packet, which would not ask for it again.
TEST_F(WelcomeBackTest, AWelcomeOnANewConnectionEndsTheOneThatWasUnderWay) {
  const ClientIndex back = core.process(1);
  add(back, Kind::subscription);
  add(back, Kind::subscription);
  connect_slowly(back);
  welcome_back.begin(back);
  ASSERT_TRUE(welcome_back.is_announcing(back));
  connect(back);  // before the daemon went on with the former one
  sent.clear();
  welcome_back.begin(back);
  EXPECT_EQ(sent.size(), 2u);
  EXPECT_FALSE(welcome_back.is_announcing(back));
  welcome_back.go_on();
  EXPECT_EQ(sent.size(), 2u);
}

TEST_F(WelcomeBackTest, AProcessThatEndsWhileItIsWelcomedIsSentNothingMore) {
  const ClientIndex back = core.process(1), other = core.process(1);
  for (const ClientIndex client : {back, other}) {
    add(client, Kind::subscription);
    add(client, Kind::subscription);
  }
  Session& session = connect_slowly(back);
  Session& session_of_other = connect_slowly(other);
  welcome_back.begin(back);
  welcome_back.begin(other);
  welcome_back.forget_client(back);
  EXPECT_FALSE(welcome_back.is_announcing(back));
  EXPECT_TRUE(welcome_back.is_announcing(other));
  read(session);
  EXPECT_EQ(count_to(back), 1u);
  read_all(other, session_of_other);
  EXPECT_EQ(count_to(other), 2u);
}

TEST_F(WelcomeBackTest, NoticesThatWereMissedComeAfterTheLastPart) {
  const ClientIndex back = core.process(1);
  const EndpointRef publisher = add(back, Kind::publisher);
  announcer.notice(publisher, Errc::type_mismatch, "it was away");
  const EndpointRef second = add(back, Kind::publisher);
  Session& session = connect_slowly(back);
  welcome_back.begin(back);
  EXPECT_EQ(lines(), (std::vector<Line>{{back, Opcode::own}}));
  read(session);
  EXPECT_EQ(own_endpoints_sent(), (std::vector{publisher, second}));
  read_all(back, session);
  EXPECT_EQ(lines().back(), (Line{back, Opcode::notice}));
  EXPECT_EQ(sent.size(), 3u);
  welcome_back.begin(back);
  session.drop_output();
  read_all(back, session);
  EXPECT_EQ(all<wire::Notice>(Opcode::notice).size(), 1u) << "once";
}

}  // namespace
}  // namespace agnocast::daemon
