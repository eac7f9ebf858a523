// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process is notified of exactly the endpoints that concern it, after that is recorded,
// when an endpoint is created and when a process comes back. Method: a registry only; the effects
// show which process is notified of which endpoint.

#include <daemon/lifecycle/announcing.hpp>
#include <tests/support/registry_scene.hpp>

#include <gtest/gtest.h>

#include <variant>
#include <vector>

namespace agnocast::daemon {
namespace {

using test::count_of;

class AnnouncingTest : public testing::Test {
 protected:
  template <class Kind>
  static std::vector<Kind> all(const Effects& effects) {
    std::vector<Kind> found;
    for (const Effect& one : effects) {
      if (const auto* const it = std::get_if<Kind>(&one)) found.push_back(*it);
    }
    return found;
  }
  /// Returns the position of the first effect of this type.
  template <class Kind>
  static std::size_t place_of(const Effects& effects) {
    std::size_t at = 0;
    while (at < effects.size() && !std::holds_alternative<Kind>(effects[at])) ++at;
    return at;
  }
  EndpointRef subscription_with_history(ClientIndex owner) {
    const abi::Qos qos{1, true, true, false, false};
    const TopicIndex at = scene.topic("/topic");
    const auto plan = registry.plan_subscription(owner, at, qos, {1, 1}).value();
    registry.add_subscription(owner, at, qos, {1, 1}, 0, plan, "node");
    return {Kind::subscription, at, plan.index};
  }

  test::RegistryScene scene;
  Registry& registry = scene.registry;
  Endings endings{scene.registry};
  Announcing announcing{scene.registry, endings};
};

TEST_F(AnnouncingTest, RecordsReceiversThenAnswersThenNotifiesReadersThenThePublisher) {
  const ClientIndex owner = scene.process(), first = scene.process(), second = scene.process();
  const EndpointRef a = scene.subscription(first), b = scene.subscription(second);
  const EndpointRef publisher = scene.publisher(owner);
  const Effects effects = announcing.created(publisher, 42);
  ASSERT_EQ(effects.size(), 7u);
  const auto members = all<effect::RecordNotified>(effects);
  ASSERT_EQ(members.size(), 2u);
  EXPECT_EQ(members[0].to, first);
  ASSERT_TRUE(std::holds_alternative<effect::Send>(effects[2]));
  const auto& answer = std::get<effect::Send>(effects[2]);
  EXPECT_EQ(answer.to, owner);
  EXPECT_EQ(std::get<wire::EndpointCreated>(answer.packet).header.request, 42u);
  const auto notified = all<effect::Announce>(effects);
  ASSERT_EQ(notified.size(), 4u);
  EXPECT_EQ(notified[0].subject, publisher);
  EXPECT_EQ(notified[0].receiver, a);
  EXPECT_EQ(notified[1].receiver, b);
  EXPECT_EQ(notified[2].subject, a) << "a reader has mapped the publisher before it is rung";
  EXPECT_EQ(notified[2].receiver, publisher);
}

TEST_F(AnnouncingTest, NotifiesNoSubscriptionThatIgnoresItsProcess) {
  const ClientIndex owner = scene.process(), other = scene.process();
  const TopicIndex at = scene.topic("/topic");
  const abi::Qos qos{1, false, true, false, true};
  for (const ClientIndex client : {owner, other}) {
    const auto plan = registry.plan_subscription(client, at, qos, {1, 1}).value();
    registry.add_subscription(client, at, qos, {1, 1}, 0, plan, "node");
  }
  const auto notified = all<effect::Announce>(announcing.created(scene.publisher(owner), 1));
  ASSERT_EQ(notified.size(), 2u) << "the other process and the publisher, of each other";
  EXPECT_EQ(registry.owner_of(notified[0].receiver), other);
  EXPECT_EQ(registry.owner_of(notified[1].subject), other);
}

TEST_F(AnnouncingTest, SaysNothingOfTheQosOfPairsThatAreIgnored) {
  const ClientIndex owner = scene.process();
  const TopicIndex at = scene.topic("/topic");
  for (const bool ignores : {false, true}) {
    const abi::Qos qos{1, true, true, false, ignores};  // asks for a history
    const auto plan = registry.plan_subscription(owner, at, qos, {1, 1}).value();
    registry.add_subscription(owner, at, qos, {1, 1}, 0, plan, "node");
  }
  const auto notices = all<effect::Notice>(announcing.created(scene.publisher(owner), 1));
  EXPECT_EQ(notices.size(), 2u) << "the other subscription and the publisher";
}

TEST_F(AnnouncingTest, NotifiesNoEndpointThatLeavesOrIsOver) {
  const EndpointRef leaving = scene.subscription(scene.process());
  const EndpointRef orphan = scene.publisher(scene.process());
  registry.change_subscription(leaving.topic, leaving.index, EndpointState::leaving);
  scene.orphan(orphan);
  const ClientIndex owner = scene.process();
  EXPECT_EQ(announcing.created(scene.publisher(owner), 1).size(), 1u) << "the answer alone";
  const EndpointRef subscription = scene.subscription(owner);
  const auto notified = all<effect::Announce>(announcing.created(subscription, 2));
  for (const auto& one : notified)
    EXPECT_NE(one.subject, orphan) << "no subscription joins an orphan";
}

TEST_F(AnnouncingTest, AnswersAgainOnlyToTheOwner) {
  const ClientIndex owner = scene.process(), reader = scene.process();
  const EndpointRef subscription = scene.subscription(reader), publisher = scene.publisher(owner);
  const Effects effects = announcing.answered_again(publisher, 7);
  EXPECT_EQ(count_of<effect::CountAnsweredAgain>(effects), 1u);
  EXPECT_LT(place_of<effect::RecordNotified>(effects), place_of<effect::Send>(effects));
  const auto notified = all<effect::Announce>(effects);
  ASSERT_EQ(notified.size(), 1u);
  EXPECT_EQ(notified[0].subject, subscription);
  EXPECT_EQ(notified[0].receiver, publisher);
}

TEST_F(AnnouncingTest, AReaderThatComesBackIsNotifiedOfAnOrphanThatItHadJoined) {
  const ClientIndex owner = scene.process(), reader = scene.process();
  const EndpointRef publisher = scene.publisher(owner);
  const EndpointRef before = scene.subscription(reader);
  registry.notify(publisher, reader);
  scene.orphan(publisher);
  const EndpointRef after = scene.subscription(reader);
  EXPECT_EQ(count_of<effect::Announce>(announcing.to_owner(before)), 1u);
  EXPECT_EQ(count_of<effect::Announce>(announcing.to_owner(after)), 0u);
  EXPECT_EQ(count_of<effect::Send>(announcing.what_is_over(reader, publisher.topic)), 1u);
  registry.acknowledge_unmap(publisher, reader);
  EXPECT_TRUE(announcing.what_is_over(reader, publisher.topic).empty());
}

TEST_F(AnnouncingTest, APublisherThatComesBackIsAskedToUnmapDeadSubscriptions) {
  const ClientIndex owner = scene.process(), reader = scene.process();
  scene.publisher(owner);
  const EndpointRef subscription = scene.subscription(reader);
  registry.notify(subscription, owner);
  EXPECT_TRUE(announcing.what_is_over(owner, subscription.topic).empty());
  registry.change_subscription(subscription.topic, subscription.index, EndpointState::dead);
  EXPECT_EQ(count_of<effect::Send>(announcing.what_is_over(owner, subscription.topic)), 1u);
  EXPECT_EQ(count_of<effect::Announce>(announcing.to_publishers_of(subscription)), 0u);
}

TEST_F(AnnouncingTest, NotifiesBothOwnersOfAMismatchAndAnnouncesNothing) {
  const ClientIndex owner = scene.process();
  const EndpointRef publisher = scene.publisher(owner);
  subscription_with_history(scene.process());
  const Effects effects = announcing.created(publisher, 1);
  EXPECT_EQ(count_of<effect::RecordNotified>(effects), 0u);
  EXPECT_EQ(count_of<effect::Announce>(effects), 0u);
  const auto notices = all<effect::Notice>(effects);
  ASSERT_EQ(notices.size(), 2u);
  EXPECT_EQ(notices[0].policy, abi::QosPolicy::durability);
  EXPECT_EQ(count_of<effect::Notice>(announcing.answered_again(publisher, 1)), 1u);
}

}  // namespace
}  // namespace agnocast::daemon
