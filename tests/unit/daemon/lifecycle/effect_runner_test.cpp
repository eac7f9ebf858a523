// SPDX-License-Identifier: Apache-2.0
//
// Goal: effects are carried out in their order. A decision that is an effect sees the results of
// the effects before it, and its own effects run before those after it. Method: the runner over a
// registry, with connections that only count; the test reads the results from the tables.

#include <daemon/lifecycle/effect_runner.hpp>
#include <tests/support/processes/daemon_core.hpp>
#include <tests/support/registry_scene.hpp>

#include <gtest/gtest.h>

#include <vector>

namespace agnocast::daemon {
namespace {

class EffectRunnerTest : public testing::Test {
 protected:
  EffectRunnerTest() {
    runner.on_client_freed = [this](ClientIndex client) { freed.push_back(client); };
    runner.on_topic_freed = [this](TopicIndex) { ++topics_freed; };
  }
  Session& connect(ClientIndex client) { return channel.connect(client); }

  test::RegistryScene scene;
  Registry& registry = scene.registry;
  Endings endings{scene.registry};
  test::TemporaryDirectory directory;
  DescriptorStore store;
  Regions regions = Regions::create(store).value();
  Doorbells doorbells{directory.path(), store};
  test::DaemonCore::Connections channel;
  Announcer announcer{scene.registry, regions, doorbells, channel};
  EffectRunner runner{scene.registry, endings, announcer, doorbells, channel};
  std::vector<ClientIndex> freed;
  int topics_freed = 0;
};

TEST_F(EffectRunnerTest, TheLastAcknowledgementFreesPlaceTopicAndProcess) {
  const ClientIndex owner = scene.process(), reader = scene.process();
  const EndpointRef publisher = scene.publisher(owner);
  registry.notify(publisher, reader);
  registry.client_died(owner, journal::DeathReason::died);
  runner.run(endings.orphan(publisher, 0, journal::LeaveCause::nothing_open));
  registry.client_forgotten(owner);
  EXPECT_TRUE(registry.is_used(publisher));
  runner.run(endings.acknowledge(publisher, reader));
  EXPECT_FALSE(registry.is_used(publisher));
  EXPECT_EQ(topics_freed, 1);
  EXPECT_TRUE(freed.empty()) << "its region is still mapped";
  runner.run({effect::AcknowledgeRegion{owner, reader}, effect::FreeUnusedClient{owner}});
  EXPECT_EQ(freed, std::vector{owner});
  EXPECT_EQ(registry.client(owner).state, ClientState::free);
}

TEST_F(EffectRunnerTest, EachPeerOfAnOrphanIsSentOnePacket) {
  const ClientIndex owner = scene.process(), reader = scene.process(), away = scene.process();
  const EndpointRef publisher = scene.publisher(owner);
  for (const ClientIndex to : {reader, away}) registry.notify(publisher, to);
  Session& session = connect(reader);
  Session& own = connect(owner);
  runner.run(endings.orphan(publisher, 0, journal::LeaveCause::left));
  EXPECT_EQ(session.packet_count(), 1u);
  EXPECT_EQ(own.packet_count(), 0u);
  EXPECT_EQ(registry.publisher(publisher.topic, publisher.index).state, EndpointState::orphan);
}

TEST_F(EffectRunnerTest, ADecisionSeesTheResultsOfTheEffectsBeforeIt) {
  const ClientIndex owner = scene.process();
  const EndpointRef subscription = scene.subscription(owner);
  runner.run({effect::FreeUnused{subscription},
              effect::ChangeSubscription{subscription, EndpointState::dead},
              effect::FreeUnused{subscription}, effect::FreeUnused{subscription}});
  EXPECT_FALSE(registry.is_used(subscription)) << "the first was too early, the third too late";
  EXPECT_EQ(topics_freed, 1);
}

TEST_F(EffectRunnerTest, ForgetsInTheBookOfTheCurrentConnection) {
  const ClientIndex reader = scene.process();
  const Announced subject{Kind::publisher, 1, 2};
  runner.run({effect::ForgetAnnounced{reader, subject}});
  Session& session = connect(reader);
  session.announcements().announced(subject, 1);
  runner.run({effect::ForgetAnnounced{reader, subject}});
  EXPECT_EQ(session.announcements().size(), 0u);
  runner.run({effect::BeginAnew{reader}});
  EXPECT_EQ(channel.session_of(reader), nullptr);
}

}  // namespace
}  // namespace agnocast::daemon
