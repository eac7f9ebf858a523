// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process is sent an announcement only after that is recorded, with the descriptors that it
// needs and no other user's, and the notes of its connection tell in which packet. Method: an
// announcer over the daemon's core; connections that keep each packet, which the test completes as
// if it was about to be sent.

#include <daemon/lifecycle/announcer.hpp>
#include <tests/unit/daemon/lifecycle/lifecycle_fixture.hpp>

#include <gtest/gtest.h>

#include <sys/resource.h>

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::daemon {
namespace {

using wire::Opcode;

/// While it exists, this process gets no descriptor more.
class NoDescriptors {
 public:
  NoDescriptors() {
    EXPECT_EQ(::getrlimit(RLIMIT_NOFILE, &before_), 0);
    const rlimit none{0, before_.rlim_max};
    EXPECT_EQ(::setrlimit(RLIMIT_NOFILE, &none), 0);
  }
  ~NoDescriptors() { ::setrlimit(RLIMIT_NOFILE, &before_); }
  NoDescriptors(const NoDescriptors&) = delete;
  NoDescriptors& operator=(const NoDescriptors&) = delete;

 private:
  rlimit before_{};
};

class AnnouncerTest : public LifecycleTest {
 protected:
  /// A publisher and a subscription that know each other; neither process is connected.
  struct Pair {
    ClientIndex owner{}, reader{};
    EndpointRef publisher, subscription;
  };
  Pair make_pair(std::uint32_t owner_uid = 1000, std::uint32_t reader_uid = 1000) {
    Pair made{core.process(owner_uid), core.process(reader_uid), {}, {}};
    made.subscription = add(made.reader, Kind::subscription);
    made.publisher = add(made.owner, Kind::publisher);
    return made;
  }
  /// Returns the process's eventfd, and keeps its receiver open, so that it can be rung.
  SharedFd open_doorbell(ClientIndex client) {
    receivers.push_back(core.doorbells.open(client, 0, 0).value());
    return receivers.back().at(0);
  }
  /// Returns the last packet as it leaves.
  Sent last_sent() {
    Sent leaves = sent.back();
    if (leaves.packet.complete) leaves.packet.complete(leaves.packet);
    return leaves;
  }
  void open_window(ClientIndex owner, const WindowRecord& window) {
    ASSERT_TRUE(core.regions.open_window(owner, window.base, 0));
    registry.open_window(owner, window);
  }

  Announcer announcer{core.registry, core.regions, core.doorbells, core.channel};
  std::vector<std::vector<SharedFd>> receivers;
};

TEST_F(AnnouncerTest, RecordsTheReceiverBeforeItSendsAndAlsoWithoutAConnection) {
  const Pair pair = make_pair();
  registry.acknowledge_unmap(pair.publisher, pair.reader);
  announcer.announce(pair.publisher, pair.subscription);
  EXPECT_TRUE(is_notified(pair.publisher, pair.reader));

  registry.acknowledge_unmap(pair.publisher, pair.reader);
  connect(pair.reader);
  bool was_sent = false;
  core.channel.on_send = [&](ClientIndex to, const Outgoing&) {
    was_sent = to == pair.reader && is_notified(pair.publisher, pair.reader);
  };
  announcer.announce(pair.publisher, pair.subscription);
  EXPECT_TRUE(was_sent);
}

TEST_F(AnnouncerTest, NeitherADeadProcessNorLostMemoryIsRecorded) {
  const Pair pair = make_pair();
  const ClientIndex lost = registry.add_client({1000, 1000, 1, 0, "without a region"}).value();
  const abi::Qos qos{1, false, true, false, false};
  const auto plan = registry.plan_publisher(lost, pair.publisher.topic, qos).value();
  registry.add_publisher(lost, pair.publisher.topic, qos, plan, "node");
  const EndpointRef of_lost{Kind::publisher, pair.publisher.topic, plan.index};
  connect(pair.reader);
  announcer.announce(of_lost, pair.subscription);
  EXPECT_FALSE(is_notified(of_lost, pair.reader));

  registry.acknowledge_unmap(pair.publisher, pair.reader);
  registry.client_died(pair.reader, journal::DeathReason::died);
  announcer.announce(pair.publisher, pair.subscription);
  EXPECT_FALSE(is_notified(pair.publisher, pair.reader));
  EXPECT_TRUE(sent.empty());
}

TEST_F(AnnouncerTest, AReaderGetsTheRegionAndAllWindowsOfAPublisher) {
  const ClientIndex owner = core.process(1), reader = core.process(2);
  const EndpointRef before = add(owner, Kind::publisher);
  add(reader, Kind::subscription);
  CreateRequest asked = core.request(Kind::subscription, "/topic");
  asked.quota = 600;  // more than it may have of others
  const EndpointRef subscription = core.create(reader, asked);
  const EndpointRef after = add(owner, Kind::publisher);
  constexpr WindowRecord windows[] = {{0x200000000000, 1 << 20, 0}, {0x200000200000, 2 << 20, 1}};
  for (const WindowRecord& window : windows) open_window(owner, window);
  connect(reader);
  announcer.announce(before, subscription);
  announcer.announce(after, subscription);
  ASSERT_EQ(sent.size(), 2u);
  EXPECT_EQ(sent[0].body<wire::Announcement>().from_start, 0u);

  const auto packet = sent[1].body<wire::Announcement>();
  const PublisherRecord& record = registry.publisher(after.topic, after.index);
  const SubscriptionRecord& own = registry.subscription(subscription.topic, subscription.index);
  EXPECT_EQ(place_in(packet), after);
  EXPECT_EQ(packet.generation, record.generation);
  EXPECT_EQ(packet.own_index, subscription.index);
  EXPECT_EQ(packet.own_generation, own.generation);
  EXPECT_EQ(packet.client, number(owner));
  EXPECT_EQ(packet.client_generation, registry.client(owner).generation);
  EXPECT_EQ(packet.extent, record.extent);
  EXPECT_EQ(packet.qos.policies, record.qos.policies);
  EXPECT_EQ(packet.qos.deadline_ns, record.qos.deadline_ns);
  EXPECT_EQ(packet.qos.lifespan_ns, record.qos.lifespan_ns);
  EXPECT_EQ(packet.qos.lease_ns, record.qos.lease_ns);
  EXPECT_EQ(packet.uid, 1u);
  EXPECT_EQ(packet.first_sequence, abi::first_sequence_of(record.generation));
  EXPECT_EQ(packet.from_start, 1u);
  EXPECT_EQ(packet.quota, own.quota_of_others);
  ASSERT_NE(own.quota_of_others, own.quota);
  ASSERT_EQ(packet.window_count, 2u);
  for (int i : {0, 1}) {
    EXPECT_EQ(packet.window[i].base, windows[i].base);
    EXPECT_EQ(packet.window[i].bytes, windows[i].bytes);
    EXPECT_EQ(packet.window[i].first, windows[i].first);
  }
  const auto& readers = core.regions.window_readers(owner);
  EXPECT_EQ(sent[1].packet.fds,
            (std::vector{core.regions.region_reader(owner), readers.at(0), readers.at(1)}));
}

TEST_F(AnnouncerTest, OneUserIsTheSameUidInTheSameKnownUserNamespace) {
  const Pair of_one = make_pair(1, 1), of_two = make_pair(1, 2);
  struct Case {
    const Pair* pair;
    std::uint64_t of_owner, of_reader;  // user namespaces; 0: unknown
    bool is_same;
  };
  for (const Case& one :
       {Case{&of_one, 7, 7, true}, Case{&of_one, 7, 8, false}, Case{&of_one, 0, 0, false},
        Case{&of_one, 7, 0, false}, Case{&of_two, 7, 7, false}}) {
    const Pair& pair = *one.pair;
    connect(pair.owner);
    connect(pair.reader);
    const SharedFd eventfd = open_doorbell(pair.reader);
    core.channel.user_namespaces = {{pair.owner, one.of_owner}, {pair.reader, one.of_reader}};
    announcer.announce(pair.publisher, pair.subscription);
    EXPECT_EQ(last_sent().body<wire::Announcement>().same_user, one.is_same ? 1u : 0u);
    announcer.announce(pair.subscription, pair.publisher);
    const Sent packet = last_sent();
    EXPECT_EQ(packet.body<wire::Announcement>().same_user, one.is_same ? 1u : 0u);
    EXPECT_EQ(packet.body<wire::Announcement>().doorbell_count, one.is_same ? 2u : 1u);
    const auto& fds = packet.packet.fds;
    ASSERT_EQ(fds.size(), one.is_same ? 3u : 2u);
    EXPECT_EQ(fds[0], core.regions.region_reader(pair.reader));
    EXPECT_EQ(std::count(fds.begin(), fds.end(), eventfd), one.is_same ? 1 : 0)
        << "a process of another user could block those who ring it";
  }
}

TEST_F(AnnouncerTest, AQueuedPacketCostsNoDoorbells) {
  const Pair pair = make_pair();
  connect(pair.owner);
  open_doorbell(pair.reader);
  announcer.announce(pair.subscription, pair.publisher);
  EXPECT_EQ(sent.back().packet.fds.size(), 1u);
  EXPECT_EQ(sent.back().body<wire::Announcement>().doorbell_count, 0u);
  EXPECT_EQ(last_sent().packet.fds.size(), 2u);
}

TEST_F(AnnouncerTest, APacketThatWaitedBringsNoDoorbellsOfALaterSubscriptionInThePlace) {
  const Pair pair = make_pair(1, 2);
  const ClientIndex other = core.process(3);
  connect(pair.owner);
  open_doorbell(pair.reader);
  open_doorbell(other);
  announcer.announce(pair.subscription, pair.publisher);
  const auto brings_none = [&] {
    const Sent packet = last_sent();
    return packet.packet.fds.size() == 1 && packet.body<wire::Announcement>().doorbell_count == 0;
  };
  EXPECT_FALSE(brings_none());
  const auto& [kind, topic, index] = pair.subscription;
  registry.change_subscription(topic, index, EndpointState::leaving);
  EXPECT_FALSE(brings_none()) << "the publisher still looks at it";
  registry.change_subscription(topic, index, EndpointState::dead);
  EXPECT_TRUE(brings_none());
  registry.acknowledge_unmap(pair.subscription, pair.owner);
  registry.free_subscription(topic, index);
  EXPECT_TRUE(brings_none());
  core.channel.on_send = nullptr;  // the packet that waits stays the last one
  ASSERT_EQ(add(other, Kind::subscription), pair.subscription);
  EXPECT_TRUE(brings_none());
}

TEST_F(AnnouncerTest, ASubscriptionWaitsOnceForTheDescriptorsOfItsDoorbells) {
  const Pair pair = make_pair();
  const EndpointRef second = add(pair.owner, Kind::publisher);
  connect(pair.owner);
  open_doorbell(pair.reader);
  {
    const NoDescriptors none;
    for (const EndpointRef& publisher : {pair.publisher, second}) {
      announcer.announce(pair.subscription, publisher);
      const Sent packet = last_sent();
      EXPECT_EQ(packet.packet.fds.size(), 1u);
      EXPECT_EQ(packet.body<wire::Announcement>().doorbell_count, 0u);
    }
  }
  EXPECT_TRUE(announcer.has_waiting());
  Announcer::ByGeneration waiting;
  announcer.move_waiting_to(waiting);
  EXPECT_EQ(
      waiting,
      (Announcer::ByGeneration{{registry.generation_of(pair.subscription), pair.subscription}}));
  EXPECT_FALSE(announcer.has_waiting());
  last_sent();
  EXPECT_FALSE(announcer.has_waiting()) << "there are descriptors again";
}

TEST_F(AnnouncerTest, NothingWaitsTwiceThatIsToBeAnnouncedAgainAnyway) {
  const Pair pair = make_pair();
  connect(pair.owner);
  open_doorbell(pair.reader);
  announcer.announce(pair.subscription, pair.publisher);
  {
    const NoDescriptors none;
    last_sent();
  }
  Announcer::ByGeneration renewed{{registry.generation_of(pair.subscription), pair.subscription}};
  announcer.move_waiting_to(renewed);
  EXPECT_EQ(renewed.size(), 1u);
  EXPECT_FALSE(announcer.has_waiting());
}

TEST_F(AnnouncerTest, TheBookOfAConnectionHasTheNumberOfThePacketThatAnnounced) {
  const Pair pair = make_pair();
  Session& session = connect(pair.reader);
  const auto announced_in = [&](const Announced& subject, std::uint64_t packet) {
    return session.announcements().is_void(subject, packet - 1) &&
           !session.announcements().is_void(subject, packet);
  };
  session.push({}, {});  // 1
  announcer.announce(pair.publisher, pair.subscription);
  EXPECT_TRUE(announced_in(subject_of(pair.publisher), 2));
  EXPECT_TRUE(announced_in(region_of(pair.owner), 2));
  announcer.announce_region(pair.reader, pair.owner);
  EXPECT_TRUE(announced_in(region_of(pair.owner), 3));
  open_window(pair.owner, {0x200000000000, 1 << 20, 0});
  announcer.announce_window(pair.owner);
  EXPECT_TRUE(announced_in(region_of(pair.owner), 4));
  EXPECT_TRUE(announced_in(subject_of(pair.publisher), 2)) << "a window is no endpoint";
  EXPECT_EQ(session.packet_count(), 4u);
}

TEST_F(AnnouncerTest, ANewWindowIsSentOnceToThoseThatReadInIt) {
  const ClientIndex owner = core.process(1), reader = core.process(2), away = core.process(2);
  const ClientIndex publishes = core.process(2), other = core.process(2);
  for (int i = 0; i < 2; ++i) add(owner, Kind::publisher);
  add(owner, Kind::subscription, "/other");
  add(reader, Kind::subscription);
  add(away, Kind::subscription);
  add(publishes, Kind::publisher, "/other");
  for (const ClientIndex client : {owner, reader, publishes, other}) connect(client);
  ASSERT_TRUE(registry.client(owner).notified.contains(number(publishes)));
  open_window(owner, {0x200000000000, 1 << 20, 0});
  open_window(owner, {0x200000200000, 2 << 20, 1});
  announcer.announce_window(owner);
  EXPECT_EQ(lines(), (std::vector<Line>{{reader, Opcode::window_announced}}));
  const auto packet = sent.at(0).body<wire::WindowAnnounced>();
  EXPECT_EQ(packet.client, number(owner));
  EXPECT_EQ(packet.client_generation, registry.client(owner).generation);
  EXPECT_EQ(packet.window, 1u);
  EXPECT_EQ(packet.base, 0x200000200000u);
  EXPECT_EQ(packet.bytes, 2u << 20);
  EXPECT_EQ(packet.first, 1u);
  EXPECT_EQ(sent[0].packet.fds, (std::vector{core.regions.window_readers(owner).at(1)}));
}

TEST_F(AnnouncerTest, ARegionIsNamedOnlyToAProcessThatHasIt) {
  const Pair pair = make_pair();
  const ClientIndex other = connected_process(), gone = core.process(3);
  registry.client_died(gone, journal::DeathReason::died);
  registry.client_forgotten(gone);
  registry.free_client(gone);
  connect(pair.reader);
  announcer.announce_region(other, pair.owner);
  announcer.announce_region(pair.reader, gone);
  EXPECT_TRUE(sent.empty());
  announcer.announce_region(pair.reader, pair.owner);
  EXPECT_EQ(lines(), (std::vector<Line>{{pair.reader, Opcode::region}}));
  const auto packet = sent.at(0).body<wire::Reference>();
  EXPECT_EQ(packet.kind, Kind::region);
  EXPECT_EQ(packet.index, number(pair.owner));
  EXPECT_EQ(packet.generation, registry.client(pair.owner).generation);
}

TEST_F(AnnouncerTest, TheFirstNoticesForAProcessThatIsAwayAreKeptAndSentOnce) {
  const Pair pair = make_pair();
  announcer.notice(pair.publisher, Errc::arena_occupied, "is found again");
  for (int i = 0; i < 100; ++i)
    announcer.notice(pair.publisher, Errc::qos_incompatible, "notice " + std::to_string(i),
                     abi::QosPolicy::durability);
  announcer.notice(pair.subscription, Errc::type_mismatch, "for the other one");
  connect(pair.owner);
  announcer.send_missed_notices(pair.owner);
  announcer.send_missed_notices(pair.owner);
  EXPECT_EQ(sent.size(), 64u);
  const auto notices = all<wire::Notice>(Opcode::notice);
  ASSERT_EQ(notices.size(), 64u);
  EXPECT_STREQ(notices.back().text.text, "notice 63");
  const wire::Notice& first = notices.front();
  EXPECT_STREQ(first.text.text, "notice 0");
  EXPECT_EQ(place_in(first), pair.publisher);
  EXPECT_EQ(first.generation, registry.generation_of(pair.publisher));
  EXPECT_EQ(first.code, static_cast<std::uint32_t>(Errc::qos_incompatible));
  EXPECT_EQ(first.policy, abi::QosPolicy::durability);

  announcer.notice(pair.publisher, Errc::arena_occupied, "at once");
  EXPECT_EQ(sent.size(), 65u);
  announcer.forget_client(pair.reader);
  connect(pair.reader);
  announcer.send_missed_notices(pair.reader);
  EXPECT_EQ(sent.size(), 65u);
}

TEST_F(AnnouncerTest, AMatchIsReportedForEachPublisherThatWasSentToItsReader) {
  const Pair pair = make_pair();
  std::vector<std::pair<EndpointRef, EndpointRef>> matched;
  announcer.on_matched = [&](const EndpointRef& publisher, const EndpointRef& subscription) {
    matched.emplace_back(publisher, subscription);
  };
  announcer.announce(pair.publisher, pair.subscription);
  connect(pair.owner);
  announcer.announce(pair.subscription, pair.publisher);
  EXPECT_TRUE(matched.empty()) << "the reader has no connection";
  connect(pair.reader);
  announcer.announce(pair.publisher, pair.subscription);
  EXPECT_EQ(matched, (std::vector{std::pair{pair.publisher, pair.subscription}}));
}

}  // namespace
}  // namespace agnocast::daemon
