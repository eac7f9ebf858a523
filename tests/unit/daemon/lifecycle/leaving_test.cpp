// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process can end and acknowledge only its own endpoints and its own announcements, each
// once, and gets the answer again if it was lost. Method: a registry and the announcement numbers
// of one connection; each packet is one that a process could send.

#include <daemon/lifecycle/leaving.hpp>
#include <daemon/lifecycle/references.hpp>
#include <tests/support/registry_scene.hpp>

#include <gtest/gtest.h>

#include <memory>

namespace agnocast::daemon {
namespace {

using test::count_of;

class LeavingTest : public testing::Test {
 protected:
  Result<Effects> leave(ClientIndex client, const EndpointRef& ref, bool again = false) {
    return leaving.leave(client, {again, scene.reference(ref)}, 9);
  }
  Result<Effects> drained(ClientIndex client, const EndpointRef& ref, bool again = false) {
    return leaving.drained(client, {again, scene.reference(ref)});
  }
  Result<Effects> unlinked(ClientIndex client, const EndpointRef& ref, std::uint64_t seen) {
    wire::Unlinked statement{};
    statement.kind = ref.kind;
    statement.topic = number(ref.topic);
    statement.index = ref.index;
    statement.generation = registry.generation_of(ref);
    statement.seen = seen;
    return leaving.unlinked(client, statement, {numbers, packet_count, false});
  }
  Result<Effects> region_unlinked(ClientIndex client, ClientIndex owner,
                                  bool is_being_announced_to) {
    wire::Unlinked statement{};
    statement.kind = Kind::region;
    statement.index = number(owner);
    statement.generation = registry.client(owner).generation;
    statement.seen = packet_count;
    return leaving.unlinked(client, statement, {numbers, packet_count, is_being_announced_to});
  }

  test::RegistryScene scene;
  Registry& registry = scene.registry;
  Endings endings{scene.registry};
  Leaving leaving{scene.registry, endings};
  AnnouncementNumbers numbers{std::make_shared<KeptForUser>()};
  std::uint64_t packet_count = 10;
};

TEST_F(LeavingTest, NoProcessEndsAnotherOnesEndpointOrAnEarlierGeneration) {
  const ClientIndex owner = scene.process(), other = scene.process();
  const EndpointRef publisher = scene.publisher(owner);
  ASSERT_FALSE(leave(other, publisher));
  EXPECT_EQ(leave(other, publisher).error().code, Errc::protocol_violation);
  auto former = scene.reference(publisher);
  --former.generation;
  EXPECT_FALSE(leaving.leave(owner, {false, former}, 9));
  auto nowhere = scene.reference(publisher);
  nowhere.topic = 1000;
  EXPECT_FALSE(leaving.leave(owner, {false, nowhere}, 9));
}

TEST_F(LeavingTest, APublisherLeavesOnceAndIsAnsweredAfterTheRecord) {
  const ClientIndex owner = scene.process();
  const EndpointRef publisher = scene.publisher(owner);
  const auto effects = leave(owner, publisher);
  ASSERT_TRUE(effects);
  ASSERT_TRUE(std::holds_alternative<effect::OrphanPublisher>(effects->front()));
  EXPECT_EQ(std::get<effect::OrphanPublisher>(effects->front()).final_head, 9u);
  EXPECT_TRUE(std::holds_alternative<effect::FreeUnused>(effects->back()));
  scene.orphan(publisher);
  EXPECT_FALSE(leave(owner, publisher)) << "it has left before";
  const auto again = leave(owner, publisher, true);
  ASSERT_TRUE(again);
  EXPECT_EQ(again->size(), 2u);
  EXPECT_EQ(count_of<effect::CountAnsweredAgain>(*again), 1u);
  EXPECT_EQ(count_of<effect::Send>(*again), 1u);
}

TEST_F(LeavingTest, NothingIsDrainedBeforeItHasLeft) {
  const ClientIndex owner = scene.process();
  const EndpointRef publisher = scene.publisher(owner), subscription = scene.subscription(owner);
  EXPECT_FALSE(drained(owner, publisher));
  EXPECT_FALSE(drained(owner, subscription));
  registry.change_subscription(subscription.topic, subscription.index, EndpointState::leaving);
  EXPECT_TRUE(drained(owner, subscription));
}

TEST_F(LeavingTest, ADrainedSubscriptionAcknowledgesPublishersWithoutAnotherReaderInItsProcess) {
  const ClientIndex owner = scene.process(), reader = scene.process();
  const EndpointRef publisher = scene.publisher(owner), first = scene.subscription(reader);
  registry.notify(publisher, reader);
  registry.change_subscription(first.topic, first.index, EndpointState::leaving);
  EXPECT_EQ(count_of<effect::Acknowledge>(drained(reader, first).value()), 1u);
  scene.subscription(reader);
  EXPECT_EQ(count_of<effect::Acknowledge>(drained(reader, first).value()), 0u);
}

TEST_F(LeavingTest, OnlyTheLastDrainedPublisherOfAProcessAcknowledgesTheReaders) {
  const ClientIndex owner = scene.process();
  const EndpointRef first = scene.publisher(owner), second = scene.publisher(owner);
  scene.subscription(scene.process());
  for (const EndpointRef& ref : {first, second}) {
    scene.orphan(ref);
    registry.end_publisher(ref.topic, ref.index, EndpointState::over);
  }
  EXPECT_EQ(count_of<effect::Acknowledge>(drained(owner, first).value()), 0u);
  registry.end_publisher(first.topic, first.index, EndpointState::free);
  EXPECT_EQ(count_of<effect::Acknowledge>(drained(owner, second).value()), 1u);
}

TEST_F(LeavingTest, AStatementMadeBeforeTheLastAnnouncementIsVoid) {
  const ClientIndex owner = scene.process(), reader = scene.process();
  const EndpointRef publisher = scene.publisher(owner);
  registry.notify(publisher, reader);
  numbers.announced(subject_of(publisher), 5);
  EXPECT_EQ(unlinked(reader, publisher, 11).error().code, Errc::protocol_violation)
      << "a client cannot have read more packets than were sent";
  EXPECT_TRUE(unlinked(reader, publisher, 4)->empty());
  const auto effects = unlinked(reader, publisher, 5);
  ASSERT_TRUE(effects);
  EXPECT_EQ(count_of<effect::ForgetAnnounced>(*effects), 1u);
  EXPECT_EQ(count_of<effect::Acknowledge>(*effects), 1u);
}

TEST_F(LeavingTest, AnAnnouncementThatTheBookHasDroppedIsRepeatedOnANewConnection) {
  const auto user = std::make_shared<KeptForUser>();
  user->noted_bytes = NotedBytes::of_user_max;  // other processes of the user have the rest
  AnnouncementNumbers small(user);
  for (std::uint32_t i = 0; i < 1000; ++i) small.announced({Kind::publisher, 1, i}, i + 1);
  const ClientIndex owner = scene.process(), reader = scene.process();
  const EndpointRef publisher = scene.publisher(owner);
  registry.notify(publisher, reader);
  wire::Unlinked statement{};
  statement.kind = Kind::publisher;
  statement.generation = registry.generation_of(publisher);
  statement.seen = 1;
  const auto effects = leaving.unlinked(reader, statement, {small, 1000, false});
  ASSERT_TRUE(effects);
  EXPECT_EQ(count_of<effect::BeginAnew>(*effects), 1u);
  EXPECT_EQ(effects->size(), 1u);
}

TEST_F(LeavingTest, ARegionIsAcknowledgedAfterAllItsEndpoints) {
  const ClientIndex owner = scene.process(), reader = scene.process();
  const EndpointRef publisher = scene.publisher(owner);
  registry.notify(publisher, reader);
  EXPECT_FALSE(region_unlinked(reader, owner, false)) << "one of its publishers is mapped";
  registry.acknowledge_unmap(publisher, reader);
  EXPECT_TRUE(region_unlinked(reader, owner, true)->empty())
      << "an announcement of another endpoint may be on its way";
  const auto effects = region_unlinked(reader, owner, false);
  ASSERT_TRUE(effects);
  EXPECT_EQ(count_of<effect::AcknowledgeRegion>(*effects), 1u);
  EXPECT_EQ(count_of<effect::FreeUnusedClient>(*effects), 1u);
}

TEST_F(LeavingTest, ALateAcknowledgementChangesNothing) {
  const ClientIndex owner = scene.process(), reader = scene.process();
  wire::Unlinked statement{};
  statement.kind = Kind::publisher;
  statement.topic = 4000;
  EXPECT_TRUE(leaving.unlinked(reader, statement, {numbers, packet_count, false})->empty());
  statement.kind = Kind::region;
  statement.index = number(owner);
  statement.generation = registry.client(owner).generation + 1;
  EXPECT_TRUE(leaving.unlinked(reader, statement, {numbers, packet_count, false})->empty());
  statement.index = std::uint64_t{1} << 40;
  EXPECT_TRUE(leaving.unlinked(reader, statement, {numbers, packet_count, false})->empty());
}

}  // namespace
}  // namespace agnocast::daemon
