// SPDX-License-Identifier: Apache-2.0
//
// Goal: the end of an endpoint rings and notifies exactly the processes concerned, in the order
// that a death of the daemon requires, and a place is free only when no process has it any more.
// Method: a registry only; the decisions are compared with its contents. Decisions write no record.

#include <daemon/lifecycle/endings.hpp>
#include <tests/support/registry_scene.hpp>

#include <gtest/gtest.h>

#include <set>
#include <variant>

namespace agnocast::daemon {
namespace {

using test::count_of;

class EndingsTest : public testing::Test {
 protected:
  std::set<ClientIndex> receivers(const Effects& effects) const {
    std::set<ClientIndex> found;
    for (const Effect& one : effects) {
      if (const auto* const send = std::get_if<effect::Send>(&one)) found.insert(send->to);
    }
    return found;
  }
  template <class Kind>
  static bool is(const Effects& effects, std::size_t at) {
    return at < effects.size() && std::holds_alternative<Kind>(effects[at]);
  }

  test::RegistryScene scene;
  Registry& registry = scene.registry;
  Endings endings{scene.registry};
};

TEST_F(EndingsTest, RecordsAnOrphanThenRingsReadersThenNotifiesItsPeers) {
  const ClientIndex owner = scene.process(), reader = scene.process(), knows = scene.process();
  const EndpointRef publisher = scene.publisher(owner);
  scene.subscription(reader);
  const EndpointRef left = scene.subscription(knows);
  registry.notify(publisher, reader);
  registry.notify(publisher, knows);
  registry.change_subscription(left.topic, left.index, EndpointState::leaving);
  const std::uint64_t before = scene.records();
  const Effects effects = endings.orphan(publisher, 77, journal::LeaveCause::rolled_back);
  EXPECT_EQ(scene.records(), before) << "a decision changes nothing";
  ASSERT_EQ(effects.size(), 5u);
  ASSERT_TRUE(is<effect::OrphanPublisher>(effects, 0));
  EXPECT_EQ(std::get<effect::OrphanPublisher>(effects[0]).final_head, 77u);
  EXPECT_EQ(std::get<effect::OrphanPublisher>(effects[0]).cause, journal::LeaveCause::rolled_back);
  ASSERT_TRUE(is<effect::Ring>(effects, 1));
  EXPECT_EQ(std::get<effect::Ring>(effects[1]).client, reader)
      << "a leaving subscription does not sleep";
  EXPECT_EQ(receivers(effects), (std::set{reader, knows}));
  EXPECT_EQ(std::get<wire::Orphaned>(std::get<effect::Send>(effects[2]).packet).final_head, 77u);
  EXPECT_TRUE(is<effect::GiveUpOrphans>(effects, 4)) << "its own end is sent first";
}

TEST_F(EndingsTest, ClosesASubscriptionBeforeItNotifiesPeers) {
  const ClientIndex owner = scene.process(), reader = scene.process(), stranger = scene.process();
  scene.publisher(owner);
  scene.publisher(stranger);
  const EndpointRef subscription = scene.subscription(reader);
  registry.notify(subscription, owner);
  const Effects effects = endings.close_subscription(subscription);
  ASSERT_TRUE(is<effect::ChangeSubscription>(effects, 0));
  EXPECT_EQ(std::get<effect::ChangeSubscription>(effects[0]).state, EndpointState::dead);
  EXPECT_EQ(receivers(effects), std::set{owner}) << "the other publisher never knew it";
  EXPECT_EQ(count_of<effect::Send>(effects), 2u) << "unmap it, and scan once more";
}

TEST_F(EndingsTest, FreesNoPlaceThatAPeerHas) {
  const ClientIndex owner = scene.process(), reader = scene.process();
  const EndpointRef publisher = scene.publisher(owner);
  registry.notify(publisher, reader);
  scene.orphan(publisher);
  EXPECT_TRUE(endings.free_unused(publisher).empty());
  registry.acknowledge_unmap(publisher, reader);
  EXPECT_FALSE(endings.free_unused(publisher).empty());
}

TEST_F(EndingsTest, KeepsAnActiveEndpointWithoutPeers) {
  const EndpointRef publisher = scene.publisher(scene.process());
  const Effects effects = endings.free_unused(publisher);
  EXPECT_EQ(effects.size(), count_of<effect::BeginFree>(effects));
}

TEST_F(EndingsTest, LetsALivingOwnerDrainBeforeThePlaceIsFree) {
  const ClientIndex owner = scene.process();
  const EndpointRef publisher = scene.publisher(owner);
  scene.orphan(publisher);
  const Effects effects = endings.free_unused(publisher);
  ASSERT_EQ(effects.size(), 3u);
  EXPECT_EQ(std::get<effect::EndPublisher>(effects[1]).state, EndpointState::over);
  EXPECT_EQ(std::get<effect::Send>(effects[2]).to, owner);
}

TEST_F(EndingsTest, FreesPlaceTopicAndProcessOfADeadOwner) {
  const ClientIndex owner = scene.process();
  const EndpointRef publisher = scene.publisher(owner);
  registry.client_died(owner, journal::DeathReason::died);
  scene.orphan(publisher);
  const Effects effects = endings.free_unused(publisher);
  ASSERT_EQ(effects.size(), 4u);
  EXPECT_EQ(std::get<effect::EndPublisher>(effects[1]).state, EndpointState::free);
  EXPECT_TRUE(is<effect::FreeUnusedTopic>(effects, 2));
  EXPECT_EQ(std::get<effect::FreeUnusedClient>(effects[3]).client, owner);
}

TEST_F(EndingsTest, KeepsThePlaceOfARevokedProcessUntilThatEnds) {
  const ClientIndex revoked = scene.process(), died = scene.process();
  registry.client_died(revoked, journal::DeathReason::revoked);
  registry.client_died(died, journal::DeathReason::died);
  EXPECT_TRUE(endings.free_unused_client(died).empty()) << "the daemon has not forgotten it yet";
  registry.client_forgotten(revoked);
  registry.client_forgotten(died);
  EXPECT_TRUE(endings.free_unused_client(revoked).empty());
  EXPECT_EQ(count_of<effect::FreeClient>(endings.free_unused_client(died)), 1u);
  EXPECT_EQ(endings.free_unused_clients().size(), 1u);
  registry.client_died(revoked, journal::DeathReason::died);
  EXPECT_EQ(endings.free_unused_clients().size(), 2u);
}

TEST_F(EndingsTest, OwesTheAcknowledgementsOfAProcessWithoutAReadingEndpoint) {
  const ClientIndex owner = scene.process(), reads = scene.process(), drained = scene.process();
  const EndpointRef publisher = scene.publisher(owner);
  scene.subscription(reads);
  registry.notify(publisher, reads);
  registry.notify(publisher, drained);
  const Effects effects = endings.owed_acknowledgements(Kind::publisher, publisher.topic);
  ASSERT_EQ(count_of<effect::Acknowledge>(effects), 1u);
  EXPECT_EQ(std::get<effect::Acknowledge>(effects[0]).by, drained);
  registry.client_died(drained, journal::DeathReason::died);
  EXPECT_TRUE(endings.owed_acknowledgements(Kind::publisher, publisher.topic).empty())
      << "the end of a dead process has steps of its own";
}

TEST(Endings, GiveUpTheOldestOrphansOnce) {
  test::RegistryScene scene({.publishers_per_topic = 4});
  Endings endings(scene.registry);
  const ClientIndex owner = scene.process(7), reader = scene.process(8);
  std::vector<EndpointRef> orphans;
  for (int i = 0; i < 4; ++i) {
    orphans.push_back(scene.publisher(owner));
    scene.registry.notify(orphans.back(), reader);
    scene.orphan(orphans.back());
  }
  const Effects effects = endings.give_up_orphans(orphans[0].topic);
  EXPECT_EQ(count_of<effect::Send>(effects), 2u) << "half of the places are for living publishers";
  for (const Effect& one : effects)
    EXPECT_EQ(std::get<wire::Orphaned>(std::get<effect::Send>(one).packet).final_head, 0u);
  EXPECT_TRUE(endings.give_up_orphans(orphans[0].topic).empty());
  ASSERT_EQ(endings.given_up().size(), 1u);
  EXPECT_EQ(endings.given_up().at(7).size(), 2u);
  scene.registry.acknowledge_unmap(orphans[0], reader);
  endings.free_unused(orphans[0]);
  EXPECT_EQ(endings.given_up().at(7).size(), 1u);
}

}  // namespace
}  // namespace agnocast::daemon
