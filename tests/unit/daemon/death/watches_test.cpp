// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process that holds more than its quota, or does not acknowledge an end, is found within
// a bounded number of looks, however much another user has to check. Method: registry, endpoint
// manager and regions as the daemon has them, processes without connections. One user has
// thousands of lines (of ended endpoints), another one a few, of which one is wrong; looks are
// counted.

#include <daemon/death/hold_watch.hpp>
#include <daemon/death/unmap_watch.hpp>
#include <region/views.hpp>
#include <tests/support/processes/daemon_core.hpp>

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace agnocast::daemon {
namespace {

class WatchesTest : public testing::Test {
 protected:
  WatchesTest() : core({.publishers_per_topic = 64}) {}

  region::LinkWords<SharedMemory> line(const EndpointRef& subscription, std::uint32_t publisher) {
    const SubscriptionRecord& record =
        core.registry.subscription(subscription.topic, subscription.index);
    return {core.regions.region(record.client), record.extent, publisher};
  }
  /// Creates so many of each kind on each topic, for one user: a line for each pair.
  void fill(std::uint32_t uid, int topics, int of_each) {
    const ClientIndex client = core.process(uid);
    for (int t = 0; t < topics; ++t) {
      const std::string topic = "/many" + std::to_string(uid) + '_' + std::to_string(t);
      for (int i = 0; i < of_each; ++i) {
        core.create(client, Kind::publisher, topic);
        core.create(client, Kind::subscription, topic);
      }
    }
  }
  /// Creates a process that is to unmap one publisher that was given up.
  ClientIndex debtor() {
    const ClientIndex reader = core.process(2);
    core.create(reader, Kind::subscription, "/t");
    for (int i = 0; i < 33; ++i) {
      const ClientIndex owner = core.process(1);
      core.create(owner, Kind::publisher, "/t");
      core.end(owner);
    }
    EXPECT_FALSE(core.endpoint_manager.endings().given_up().empty());
    return reader;
  }
  int looks_until_found(HoldWatch& watch, ClientIndex wanted) {
    for (int looks = 1; looks < 1000; ++looks) {
      for (const HoldWatch::Finding& finding : watch.look()) {
        if (core.registry.owner_of(finding.subscription) == wanted) return looks;
      }
    }
    return 1000;
  }

  test::DaemonCore core;
};

TEST_F(WatchesTest, FindsAnExcessiveHolderHoweverMuchAnotherUserHas) {
  const ClientIndex owner = core.process(1), liar = core.process(2);
  core.create(owner, Kind::publisher, "/victim");
  const EndpointRef subscription = core.create(liar, Kind::subscription, "/victim");
  line(subscription, 0).hold(0).store(0xff);  // its quota is one
  HoldWatch alone(core.registry, core.regions);
  const int without = looks_until_found(alone, liar);
  EXPECT_LE(without, 7);
  fill(3, 12, 60);  // 43,200 lines: eleven looks for all of them
  HoldWatch watch(core.registry, core.regions);
  EXPECT_LE(looks_until_found(watch, liar), without + 1);
}

TEST_F(WatchesTest, LooksAtSeveralUsersAtATimeHoweverMuchEachOfThemHas) {
  core.create(core.process(1), Kind::publisher, "/victim");
  // Each of them alone has more lines than one look reads, for all users.
  for (std::uint32_t uid = 2; uid < 9; ++uid) fill(uid, 2, 60);
  const ClientIndex liar = core.process(9);
  const EndpointRef subscription = core.create(liar, Kind::subscription, "/victim");
  line(subscription, 0).hold(0).store(0xff);  // its quota is one
  HoldWatch watch(core.registry, core.regions);
  EXPECT_LE(looks_until_found(watch, liar), 8);
}

TEST_F(WatchesTest, BeginsAnewWithAnotherSubscriptionAtTheSamePlace) {
  HoldWatch watch(core.registry, core.regions);
  for (int i = 0; i < 4; ++i) {
    const ClientIndex process = core.process(2);
    const EndpointRef publisher = core.create(process, Kind::publisher, "/t"),
                      subscription = core.create(process, Kind::subscription, "/t");
    ASSERT_EQ(publisher, (EndpointRef{Kind::publisher, TopicIndex{0}, 0}));
    ASSERT_EQ(subscription, (EndpointRef{Kind::subscription, TopicIndex{0}, 0}));
    line(subscription, 0).hold(0).store(0xff);
    for (int looks = 0; looks < 4; ++looks) EXPECT_TRUE(watch.look().empty()) << i;
    core.end(process);
  }
}

TEST_F(WatchesTest, ChecksEverythingOfAUserEventually) {
  fill(3, 12, 60);
  const ClientIndex owner = core.process(3);
  core.create(owner, Kind::publisher, "/zzz");
  const EndpointRef subscription = core.create(owner, Kind::subscription, "/zzz");
  line(subscription, 0).hold(0).store(0xff);
  HoldWatch watch(core.registry, core.regions);
  EXPECT_LT(looks_until_found(watch, owner), 200);
}

TEST_F(WatchesTest, FindsEachUserWithoutWaitingForAnotherUsersFindings) {
  const ClientIndex owner = core.process(1);
  std::vector<ClientIndex> liars;
  for (std::uint32_t i = 0; i < 20; ++i) liars.push_back(core.process(2));
  liars.push_back(core.process(3));
  for (std::size_t i = 0; i < liars.size(); ++i) {
    const std::string topic = "/t" + std::to_string(i);
    core.create(owner, Kind::publisher, topic);
    const EndpointRef subscription = core.create(liars[i], Kind::subscription, topic);
    line(subscription, 0).hold(0).store(0xff);
  }
  HoldWatch watch(core.registry, core.regions);
  EXPECT_LE(looks_until_found(watch, liars.back()), 7);
}

TEST_F(WatchesTest, FindsAMissingAcknowledgementHoweverMuchAnotherUserLeft) {
  const auto leave_behind = [&](std::uint32_t uid, const std::string& topic, int count) {
    const ClientIndex keeper = core.process(uid);
    core.create(keeper, Kind::subscription, topic);
    for (int i = 0; i < count; ++i) {
      const ClientIndex owner = core.process(uid);
      core.create(owner, Kind::publisher, topic);
      core.end(owner);
    }
    return keeper;
  };
  const auto looks_until = [&](ClientIndex wanted) {
    UnmapWatch watch(core.registry, core.regions, core.endpoint_manager.endings(), core.channel);
    for (int looks = 1; looks < 10'000; ++looks) {
      for (const UnmapWatch::Finding& finding : watch.look()) {
        if (finding.client == wanted) return looks;
      }
    }
    return 10'000;
  };
  const ClientIndex keeper = leave_behind(2, "/victim", 33);
  const int alone = looks_until(keeper);
  ASSERT_LT(alone, 100);
  // Many subscriptions; the watch checks every line of each.
  const ClientIndex many = core.process(1);
  for (int t = 0; t < 8; ++t) {
    const std::string topic = "/many" + std::to_string(t);
    for (int i = 0; i < 700; ++i) core.create(many, Kind::subscription, topic);
    leave_behind(1, topic, 40);
  }
  EXPECT_LE(looks_until(keeper), alone + 1);
}

TEST_F(WatchesTest, NeverFindsWhoHoldsAsManyAsItAskedFor) {
  const ClientIndex owner = core.process(1), reader = core.process(2);
  core.create(owner, Kind::publisher, "/t");
  const EndpointRef subscription = core.create(reader, Kind::subscription, "/t");
  line(subscription, 0).hold(0).store(1);  // its quota is one
  HoldWatch watch(core.registry, core.regions);
  for (int looks = 0; looks < 20; ++looks) EXPECT_TRUE(watch.look().empty());
}

TEST_F(WatchesTest, BeginsAnewWithWhoIsBackWithinItsQuotaForOneLook) {
  const ClientIndex owner = core.process(1), reader = core.process(2);
  core.create(owner, Kind::publisher, "/t");
  const EndpointRef subscription = core.create(reader, Kind::subscription, "/t");
  HoldWatch watch(core.registry, core.regions);
  for (int looks = 0; looks < 20; ++looks) {
    line(subscription, 0).hold(0).store(looks % 5 == 4 ? 1 : 0xff);
    EXPECT_TRUE(watch.look().empty()) << looks;
  }
}

TEST_F(WatchesTest, GivesAProcessThatCameBackAsLongAsOneWithoutAConnection) {
  const ClientIndex reader = debtor(), stranger = core.process(3);
  const auto looks_until_found = [&](bool comes_back) {
    UnmapWatch watch(core.registry, core.regions, core.endpoint_manager.endings(), core.channel);
    for (int looks = 1; looks < 100; ++looks) {
      const auto found = watch.look();
      if (!found.empty()) {
        EXPECT_EQ(found[0].client, reader);
        EXPECT_TRUE(watch.is_true(found[0]));
        UnmapWatch::Finding of_another = found[0];
        ++of_another.generation;
        EXPECT_FALSE(watch.is_true(of_another)) << "another endpoint";
        of_another = found[0];
        of_another.client = stranger;
        EXPECT_FALSE(watch.is_true(of_another)) << "a process that was not notified";
        return looks;
      }
      if (comes_back) watch.notified_again(reader);
    }
    return 100;
  };
  const int without_connection = looks_until_found(false);
  core.channel.sessions.emplace(reader, Session(PacketSocket(), PeerIdentity()));
  const int deaf = looks_until_found(false);
  EXPECT_LT(deaf, without_connection) << "everything was sent to it";
  EXPECT_EQ(looks_until_found(true), without_connection);
}

TEST_F(WatchesTest, GivesAProcessThatReadsWhatItIsSentMoreLooks) {
  const ClientIndex reader = debtor();
  const auto looks_until_found = [&](bool reads) {
    core.channel.sessions.clear();
    Session& session =
        core.channel.sessions.emplace(reader, Session(PacketSocket(), PeerIdentity()))
            .first->second;
    const std::byte packet{};
    UnmapWatch watch(core.registry, core.regions, core.endpoint_manager.endings(), core.channel);
    for (int looks = 1; looks < 100; ++looks) {
      if (reads) session.drop_output();  // it was sent
      if (reads || looks == 1) session.push({&packet, 1}, {});
      if (!watch.look().empty()) return looks;
    }
    return 100;
  };
  const int deaf = looks_until_found(false), reading = looks_until_found(true);
  EXPECT_LT(deaf, reading);
  EXPECT_LT(reading, 100) << "not for ever";
}

TEST_F(WatchesTest, FindsNobodyWhoHoldsAMessageOfWhatWasGivenUp) {
  const ClientIndex reader = core.process(2);
  const EndpointRef subscription = core.create(reader, Kind::subscription, "/t");
  for (int i = 0; i < 33; ++i) {
    const ClientIndex owner = core.process(1);
    const EndpointRef publisher = core.create(owner, Kind::publisher, "/t");
    line(subscription, publisher.index).hold(0).store(1);
    core.end(owner);
  }
  UnmapWatch watch(core.registry, core.regions, core.endpoint_manager.endings(), core.channel);
  for (int looks = 0; looks < 100; ++looks) ASSERT_TRUE(watch.look().empty()) << looks;
}

}  // namespace
}  // namespace agnocast::daemon
