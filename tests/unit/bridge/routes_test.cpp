// SPDX-License-Identifier: Apache-2.0
//
// Goal: the bridge has exactly what the endpoints on both sides need, every message takes one
// route once, and the plan says why an endpoint is not bridged. Method: plan_of() is pure; named
// situations, and random ones checked against DDS's matching rules for each pair of endpoints.

#include <tests/unit/bridge/routes_fixture.hpp>

namespace agnocast::bridge {
namespace {

TEST_F(Routes, BeyondAParticipantsShareGiveWayToOtherParticipants) {
  subscription("/chatter");
  const auto owned_by = [&](std::uint8_t participant) {
    const Guid guid = writer("rt/chatter");
    remotes_[guid].participant.bytes[0] = participant;
    return guid;
  };
  // All of its writers already have remote publishers.
  for (std::size_t i = 0; i < remote_publishers_per_topic_max + 10; ++i)
    has_remote_publisher_.insert(owned_by(1));
  const auto count_of = [&](std::uint8_t participant) {
    std::size_t count = 0;
    for (const auto& [guid, remote_publisher] : plan().remote_publishers)
      count += remotes_[guid].participant.bytes[0] == participant;
    return count;
  };
  EXPECT_EQ(count_of(1), remote_publishers_per_topic_max) << "no other participant wants a place";
  std::set<Guid> honest;
  for (std::size_t i = 0; i < 10; ++i) honest.insert(owned_by(2));
  EXPECT_EQ(count_of(2), honest.size());
  EXPECT_EQ(count_of(1), remote_publishers_per_topic_max - honest.size());
  // Never less than its share.
  for (std::uint8_t other = 3; other < 100; ++other) owned_by(other);
  EXPECT_EQ(count_of(1), remote_publishers_of_participant_share);
}

TEST_F(Routes, AnnounceUnreadPublishersThatAReaderWouldGet) {
  announce_ = true;
  const auto alone = publisher("/chatter", QoS(7).transient_local());
  const auto read = publisher("/read"), weak = publisher("/read", QoS(5).best_effort());
  reader("rt/read");
  publisher("/secret");
  publisher("/cut");
  publisher("/-no-ros-name");
  local(EndpointKind::publisher, "/unknown", QoS(1), "talker");
  locals_.back().type = "some_msgs/msg/Unknown";
  rules_ = {{.topic = "/secret", .direction = Direction::none, .line = 1},
            {.topic = "/cut",
             .direction = Direction::both,
             .line = 2,
             .to_dds = {.reliable = false, .transient_local = {}, .depth = 3}}};
  const Plan made = plan();
  ASSERT_THAT(made.announced, SizeIs(3)) << "the unread one, the one with too weak QoS, /cut";
  const DdsWriterPlan& announced = made.announced.at(alone);
  EXPECT_EQ(announced.local_reader.of.key, chatter);
  EXPECT_EQ(announced.node, "/ns/talker");
  EXPECT_EQ(announced.depth, 7u);
  EXPECT_EQ(announced.offered, (QosClass{true, true}));
  EXPECT_TRUE(made.announced.contains(weak));
  for (const auto& [generation, dds_writer] : made.announced) {
    if (dds_writer.local_reader.of.key.topic != "/cut") continue;
    EXPECT_FALSE(dds_writer.offered.reliable);
    EXPECT_EQ(dds_writer.depth, 3u);
  }
  ASSERT_THAT(made.dds_writers, SizeIs(1));
  EXPECT_TRUE(made.dds_writers.contains(read));
  EXPECT_THAT(made.local_readers, SizeIs(1)) << "announced topics have no local reader";
  announce_ = false;
  EXPECT_THAT(plan().announced, IsEmpty());
}

TEST_F(Routes, HaveOnlyADdsReaderForATopicThatIsHereOnly) {
  publisher("/chatter");
  subscription("/news", QoS(200).best_effort(), "one");
  reader("rt/elsewhere");
  writer("rt/elsewhere");
  const Plan nothing = plan();
  EXPECT_THAT(nothing.dds_writers, IsEmpty());
  EXPECT_THAT(nothing.local_readers, IsEmpty());
  EXPECT_THAT(nothing.remote_publishers, IsEmpty());
  // It tells other bridges that this host wants the topic.
  ASSERT_THAT(nothing.dds_readers, SizeIs(1));
  const auto& [key, dds_reader] = *nothing.dds_readers.begin();
  EXPECT_EQ(key, (ClassKey{{"/news", string_type}, {false, false}}));
  EXPECT_EQ(dds_reader.depth, 200u);
  EXPECT_THAT(dds_reader.nodes, ElementsAre("/ns/one"));
  EXPECT_THAT(
      nothing.unbridged,
      ElementsAre(Unbridged{"/chatter", string_type, Direction::outward, WhyNot::no_reader, ""},
                  Unbridged{"/news", string_type, Direction::inward, WhyNot::no_writer, ""}));
}

TEST_F(Routes, LeaveOutTheTopicsOfServices) {
  publisher("/_service/request/add");
  subscription("/_service/request/add");
  reader("rt/_service/request/add");
  writer("rt/_service/request/add");
  const Plan nothing = plan();
  EXPECT_THAT(nothing.dds_writers, IsEmpty());
  EXPECT_THAT(nothing.local_readers, IsEmpty());
  EXPECT_THAT(nothing.dds_readers, IsEmpty());
  EXPECT_THAT(nothing.remote_publishers, IsEmpty());
  EXPECT_THAT(nothing.unbridged, IsEmpty());
}

TEST_F(Routes, MirrorEachPublisherInTheNameOfItsNode) {
  const auto first = publisher("/chatter", QoS(7), "talker");
  const auto second = publisher("/chatter", QoS(3).best_effort(), "camera");
  const auto third = publisher("/chatter", QoS(5).transient_local(), "map");
  reader("rt/chatter", false);
  const Plan all = plan();
  ASSERT_THAT(all.dds_writers, SizeIs(3));
  EXPECT_EQ(all.dds_writers.at(first).node, "/ns/talker");
  EXPECT_EQ(all.dds_writers.at(first).depth, 7u);
  EXPECT_EQ(all.dds_writers.at(first).local_reader.of.qos_class, (QosClass{true, false}));
  EXPECT_EQ(all.dds_writers.at(second).local_reader.of.qos_class, (QosClass{false, false}));
  EXPECT_EQ(all.dds_writers.at(third).local_reader.of.qos_class, (QosClass{true, true}));
  EXPECT_THAT(all.local_readers,
              ElementsAre(local_reader({false, false}, 3), local_reader({true, false}, 7),
                          local_reader({true, true}, 5)));
  EXPECT_THAT(all.unbridged, IsEmpty());
}

TEST_F(Routes, PassOnThePublishersTimes) {
  using std::chrono::seconds;
  const auto timed =
      publisher("/chatter", QoS(7).deadline(seconds(1)).lifespan(seconds(2)), "talker");
  const auto other = publisher("/chatter", QoS(7), "camera");
  reader("rt/chatter", false);
  const Plan all = plan();
  EXPECT_EQ(all.dds_writers.at(timed).times.deadline, seconds(1));
  EXPECT_EQ(all.dds_writers.at(timed).times.lifespan, seconds(2));
  EXPECT_EQ(all.dds_writers.at(other).times.deadline, DdsQos::infinite);
  EXPECT_EQ(all.dds_writers.at(other).times.lifespan, DdsQos::infinite);
  EXPECT_THAT(all.local_readers, SizeIs(1)) << "they are no reason for another one";
}

TEST_F(Routes, PassOnTheWritersTimes) {
  using std::chrono::nanoseconds;
  subscription("/chatter", QoS(4), "one");
  const Guid timed = writer("rt/chatter"), plain = writer("rt/chatter");
  remotes_.at(timed).qos.deadline = nanoseconds(5);
  remotes_.at(timed).qos.lifespan = nanoseconds(0);
  const Plan all = plan();
  const auto offer = [&](const Guid& guid) {
    const RemotePublisherPlan& planned = all.remote_publishers.at(guid);
    return qos_of(planned.qos_class, planned.depth, planned.keep_all, planned.times);
  };
  EXPECT_EQ(offer(timed).deadline(), nanoseconds(5));
  EXPECT_EQ(offer(timed).lifespan(), nanoseconds(1)) << "0 would be none here";
  EXPECT_EQ(offer(plain).deadline(), nanoseconds(0)) << "infinite there";
  EXPECT_EQ(offer(plain).lifespan(), nanoseconds(0));
}

TEST_F(Routes, ShareALocalReaderAmongPublishersWithEqualQos) {
  publisher("/chatter", QoS(7));
  publisher("/chatter", QoS(7), "other");
  reader("rt/chatter");
  const Plan all = plan();
  EXPECT_THAT(all.dds_writers, SizeIs(2));
  EXPECT_THAT(all.local_readers, ElementsAre(local_reader({true, false}, 7)));
}

TEST_F(Routes, KeepALocalReadersDepthWhenOtherPublishersCome) {
  const auto first = publisher("/chatter", QoS(7));
  reader("rt/chatter");
  const DdsWriterPlan before = plan().dds_writers.at(first);
  const auto deep = publisher("/chatter", QoS(900));
  const auto all_of_it = publisher("/chatter", QoS(1).keep_all(7));
  const Plan all = plan();
  EXPECT_EQ(all.dds_writers.at(first).local_reader, before.local_reader)
      << "other publishers must not change the depth";
  EXPECT_EQ(all.dds_writers.at(deep).local_reader, local_reader({true, false}, 900));
  EXPECT_EQ(all.dds_writers.at(all_of_it).local_reader, local_reader({true, false}, 7, true));
  EXPECT_THAT(all.local_readers, SizeIs(3));
}

TEST_F(Routes, HaveDdsReadersOfFewDepths) {
  subscription("/chatter", QoS(1));
  for (const auto& [asked, made] :
       std::vector<std::pair<int, std::size_t>>{{1, 100}, {100, 100}, {101, 200}, {1000, 1600}}) {
    writer("rt/chatter", true, false, asked);
    EXPECT_EQ(plan().dds_readers.begin()->second.depth, made) << asked;
  }
}

TEST_F(Routes, GiveDdsWritersHalfOfATopicsPlacesAndLetThemKeepThese) {
  subscription("/chatter");
  std::set<Guid> all;
  for (std::size_t i = 0; i < remote_publishers_per_topic_max; ++i)
    all.insert(writer("rt/chatter"));
  EXPECT_THAT(plan().remote_publishers, SizeIs(remote_publishers_per_topic_max));
  EXPECT_THAT(plan().unbridged, IsEmpty());
  has_remote_publisher_ = all;
  for (int i = 0; i < 300; ++i) writer("rt/chatter");
  // Some of the new ones sort before some of the old ones.
  ASSERT_LT(remotes_.size(), 1000u);
  Remote early = remotes_.at(*all.begin());
  early.guid = {};
  early.guid.bytes[15] = 1;
  remotes_[early.guid] = early;
  const Plan full = plan();
  ASSERT_THAT(full.remote_publishers, SizeIs(remote_publishers_per_topic_max));
  for (const auto& [guid, remote_publisher] : full.remote_publishers)
    EXPECT_TRUE(all.contains(guid));
  ASSERT_THAT(full.unbridged, SizeIs(1));
  EXPECT_EQ(full.unbridged[0].why, WhyNot::too_many);
  EXPECT_THAT(full.unbridged[0].detail, HasSubstr("301 of 429"));
  // A place that becomes free is given away.
  remotes_.erase(*all.begin());
  EXPECT_TRUE(plan().remote_publishers.contains(early.guid));
}

TEST_F(Routes, ArePlannedQuicklyForThousandsOfEndpointsOfOneTopic) {
  constexpr int count = 20'000;
  for (int i = 0; i < count; ++i) {
    publisher("/chatter", QoS(10), "talker_" + std::to_string(i));
    subscription("/chatter", QoS(10), "listener_" + std::to_string(i));
    Remote remote = remotes_.empty() ? Remote{} : remotes_.begin()->second;
    remote.topic = "rt/chatter";
    remote.type = "std_msgs::msg::dds_::String_";
    for (const auto kind : {Remote::Kind::reader, Remote::Kind::writer}) {
      remote.kind = kind;
      for (int byte = 0; byte < 4; ++byte)
        remote.guid.bytes[static_cast<std::size_t>(byte)] =
            static_cast<std::uint8_t>((2 * i + (kind == Remote::Kind::writer)) >> 8 * byte);
      remotes_[remote.guid] = remote;
    }
  }
  // Comparing all pairs, each with its own text, would take 400 million comparisons: minutes.
  const Plan all = plan();
  EXPECT_THAT(all.dds_writers, SizeIs(count));
  EXPECT_THAT(all.remote_publishers, SizeIs(remote_publishers_per_topic_max));
  EXPECT_THAT(all.dds_readers.begin()->second.nodes, SizeIs(count));
}

TEST_F(Routes, MirrorEachDdsWriterAndReadItOnceForAllSubscriptions) {
  subscription("/chatter", QoS(4), "one");
  subscription("/chatter", QoS(400).best_effort(), "two");
  const Guid first = writer("rt/chatter", true, false, 6);
  const Guid second = writer("rt/chatter", true, false, 8);
  const Guid third = writer("rt/chatter", false, false, 0);  // no depth announced
  const Plan all = plan();
  ASSERT_THAT(all.remote_publishers, SizeIs(3));
  EXPECT_EQ(all.remote_publishers.at(first).depth, 6u);
  EXPECT_EQ(all.remote_publishers.at(second).depth, 8u);
  EXPECT_EQ(all.remote_publishers.at(third).depth, 10u);
  EXPECT_EQ(all.remote_publishers.at(third).qos_class, (QosClass{false, false}));
  ASSERT_THAT(all.dds_readers, SizeIs(2));
  const DdsReaderPlan& reliable = all.dds_readers.at({chatter, {true, false}});
  EXPECT_EQ(reliable.depth, 400u);
  EXPECT_FALSE(reliable.keep_all);
  EXPECT_THAT(reliable.nodes, ElementsAre("/ns/one", "/ns/two"));
  // A reliable subscription gets nothing from a best-effort writer.
  const DdsReaderPlan& best_effort = all.dds_readers.at({chatter, {false, false}});
  EXPECT_THAT(best_effort.nodes, ElementsAre("/ns/two"));
  EXPECT_EQ(best_effort.depth, 400u);
}

TEST_F(Routes, ReadOnceAWriterThatOffersMoreThanAnySubscriptionRequests) {
  subscription("/chatter", QoS(5).best_effort());
  const Guid all_of_it = writer("rt/chatter", true, true);
  const Plan all = plan();
  ASSERT_THAT(all.dds_readers, SizeIs(1));
  EXPECT_EQ(all.dds_readers.begin()->first.qos_class, (QosClass{false, false}));
  EXPECT_EQ(all.remote_publishers.at(all_of_it).qos_class, (QosClass{true, true}))
      << "the QoS that the writer offers";
}

TEST_F(Routes, KeepAllOfAWriterThatKeepsAll) {
  subscription("/chatter", QoS(1).keep_all(5));
  const Guid all_of_it = writer("rt/chatter");
  remotes_[all_of_it].qos.keep_all = true;
  const Guid last = writer("rt/chatter", true, false, 3);
  const Plan all = plan();
  EXPECT_TRUE(all.remote_publishers.at(all_of_it).keep_all);
  EXPECT_EQ(all.remote_publishers.at(all_of_it).depth, QoS(1).keep_all().depth());
  EXPECT_FALSE(all.remote_publishers.at(last).keep_all);
  EXPECT_TRUE(all.dds_readers.begin()->second.keep_all);
}

TEST_F(Routes, HaveRoomForMessagesWhileTheBridgeIsBusy) {
  subscription("/chatter", QoS(1));
  writer("rt/chatter", true, false, 1);
  EXPECT_EQ(plan().dds_readers.begin()->second.depth, 100u);
}

TEST_F(Routes, SayThatNoEndpointMatches) {
  publisher("/chatter", QoS(10).best_effort());
  subscription("/chatter", QoS(10).transient_local());
  reader("rt/chatter");
  writer("rt/chatter");
  const Plan nothing = plan();
  EXPECT_THAT(nothing.dds_writers, IsEmpty());
  EXPECT_THAT(nothing.remote_publishers, IsEmpty());
  ASSERT_THAT(nothing.unbridged, SizeIs(2));
  EXPECT_EQ(nothing.unbridged[0].why, WhyNot::qos);
  EXPECT_EQ(nothing.unbridged[1].why, WhyNot::qos);
}

TEST_F(Routes, FollowTheDefaultWhereNoRuleMatches) {
  publisher("/a");
  publisher("/b");
  reader("rt/a");
  reader("rt/b");
  otherwise_ = Direction::none;
  rules_ = {{"/a", Direction::both, 1}};
  const Plan made = plan();
  EXPECT_THAT(made.dds_writers, SizeIs(1));
  ASSERT_THAT(made.unbridged, SizeIs(1));
  EXPECT_EQ(made.unbridged[0].topic, "/b");
  EXPECT_EQ(made.unbridged[0].why, WhyNot::rule);
  EXPECT_THAT(made.unbridged[0].detail, HasSubstr("default"));
}

TEST_F(Routes, ARuleForATypeLeavesOtherTypesToTheNextRule) {
  publisher("/a");
  reader("rt/a");
  rules_ = {{"/a", Direction::none, 1, "std_msgs/msg/Int32"}, {"/a", Direction::outward, 2}};
  EXPECT_THAT(plan().dds_writers, SizeIs(1));
  rules_[0].type = string_type;
  EXPECT_THAT(plan().dds_writers, IsEmpty());
}

TEST_F(Routes, OfferTheRulesQosToDdsAndReadWithThePublishersQos) {
  const auto generation = publisher("/a", QoS(7).transient_local());
  reader("rt/a", false, false);
  Rule rule{"/a", Direction::both, 1};
  rule.to_dds = {false, false, 2};
  rules_ = {rule};
  const Plan made = plan();
  ASSERT_TRUE(made.dds_writers.contains(generation));
  const DdsWriterPlan& dds_writer = made.dds_writers.at(generation);
  EXPECT_EQ(dds_writer.offered, (QosClass{false, false}));
  EXPECT_EQ(dds_writer.depth, 2u);
  EXPECT_EQ(dds_writer.local_reader, (ReaderKey{{{"/a", string_type}, {true, true}}, 7, false}));
  EXPECT_THAT(made.local_readers, ElementsAre(dds_writer.local_reader));
}

TEST_F(Routes, MatchReadersAgainstTheQosOfTheRule) {
  publisher("/a", QoS(5).best_effort());
  reader("rt/a", true);
  EXPECT_THAT(plan().dds_writers, IsEmpty());
  Rule rule{"/a", Direction::both, 1};
  rule.to_dds.reliable = true;
  rules_ = {rule};
  EXPECT_THAT(plan().dds_writers, SizeIs(1));
  rules_[0].to_dds.reliable = false;
  const Plan refused = plan();
  EXPECT_THAT(refused.dds_writers, IsEmpty());
  ASSERT_THAT(refused.unbridged, SizeIs(1));
  EXPECT_EQ(refused.unbridged[0].why, WhyNot::qos);
}

TEST_F(Routes, RequestTheRulesQosFromDds) {
  subscription("/a", QoS(5).best_effort());
  const Guid reliable = writer("rt/a", true, true);
  const Guid best_effort = writer("rt/a", false);
  Rule rule{"/a", Direction::both, 1};
  rule.from_dds = {true, false, 3};
  rules_ = {rule};
  const Plan made = plan();
  EXPECT_TRUE(made.remote_publishers.contains(reliable));
  EXPECT_FALSE(made.remote_publishers.contains(best_effort)) << "the writer offers less";
  ASSERT_THAT(made.dds_readers, SizeIs(1));
  EXPECT_EQ(made.dds_readers.begin()->second.requested, (QosClass{true, false}));
  EXPECT_EQ(made.dds_readers.begin()->second.depth, 3u);
}

TEST_F(Routes, AlwaysHaveTheEndpointsOfARuleWithAlways) {
  const auto generation = publisher("/a");
  Rule rule{"/a", Direction::both, 1, string_type};
  EXPECT_THAT(plan().dds_writers, IsEmpty());
  rule.always = true;
  rules_ = {rule};
  Plan made = plan();
  EXPECT_TRUE(made.dds_writers.contains(generation)) << "no DDS reader reads it";
  ASSERT_THAT(made.dds_readers, SizeIs(1)) << "no endpoint is on either side";
  EXPECT_EQ(made.dds_readers.begin()->second.requested, (QosClass{true, false}));
  EXPECT_THAT(made.remote_publishers, IsEmpty());
  EXPECT_THAT(made.unbridged, IsEmpty());

  const Guid remote = writer("rt/a", false, false);
  made = plan();
  EXPECT_TRUE(made.remote_publishers.contains(remote)) << "no local subscription exists";
  rules_[0].direction = Direction::outward;
  made = plan();
  EXPECT_THAT(made.remote_publishers, IsEmpty());
  EXPECT_THAT(made.dds_readers, IsEmpty());
}

TEST_F(Routes, FollowTheFirstRuleThatMatches) {
  rules_ = {{"/chatter", Direction::outward, 3},
            {"/lidar/**", Direction::both, 5},
            {"**", Direction::none, 7}};
  for (const char* const topic : {"/chatter", "/lidar/top/points", "/camera"}) {
    publisher(topic);
    subscription(topic);
    reader("rt" + std::string(topic));
    writer("rt" + std::string(topic));
  }
  const Plan some = plan();
  EXPECT_THAT(some.dds_writers, SizeIs(2));
  ASSERT_THAT(some.remote_publishers, SizeIs(1));
  EXPECT_EQ(some.remote_publishers.begin()->second.key.topic, "/lidar/top/points");
  ASSERT_THAT(some.unbridged, SizeIs(3));
  for (const Unbridged& not_there : some.unbridged) EXPECT_EQ(not_there.why, WhyNot::rule);
  EXPECT_THAT(some.unbridged.back().detail, HasSubstr("line 3"));
}

TEST_F(Routes, SayWhichTypeAnotherTopicOfThatNameHas) {
  publisher("/chatter");
  remote(Remote::Kind::reader, "rt/chatter", true, false, 10, "std_msgs::msg::dds_::Int64_");
  const Plan nothing = plan();
  ASSERT_THAT(nothing.unbridged, SizeIs(1));
  EXPECT_EQ(nothing.unbridged[0].why, WhyNot::other_type);
  EXPECT_THAT(nothing.unbridged[0].detail, HasSubstr("std_msgs/msg/Int64"));
}

TEST_F(Routes, LoadATypeOnceAndOnlyWhenItIsOnBothSides) {
  for (int i = 0; i < 5; ++i)
    local(EndpointKind::publisher, "/topic_" + std::to_string(i), QoS(1), "n", "foreign/msg/Type");
  local(EndpointKind::publisher, "/alone", QoS(1), "n", "lonely/msg/Type");
  for (int i = 0; i < 5; ++i)
    remote(Remote::Kind::reader, "rt/topic_" + std::to_string(i), true, false, 1,
           "foreign::msg::dds_::Type_");
  const Plan nothing = plan();
  EXPECT_EQ(asked_, 1);
  EXPECT_THAT(nothing.dds_writers, IsEmpty());
  EXPECT_EQ(std::count_if(nothing.unbridged.begin(), nothing.unbridged.end(),
                          [](const Unbridged& one) { return one.why == WhyNot::unknown_type; }),
            5);
}

TEST_F(Routes, SayThatNoWriterIsFoundBecauseTheTypeIsUnknown) {
  local(EndpointKind::subscription, "/news", QoS(1), "n", "foreign/msg/Type");
  const Plan nothing = plan();
  ASSERT_THAT(nothing.unbridged, SizeIs(1));
  EXPECT_EQ(nothing.unbridged[0].why, WhyNot::no_writer);
  EXPECT_THAT(nothing.unbridged[0].detail, HasSubstr("is not available here"));
}

TEST_F(Routes, LeaveOutBridgesOtherDomainsServicesAndNamesOutsideRos) {
  local(EndpointKind::publisher, "/chatter", QoS(1), std::string(bridge_node));
  local(EndpointKind::subscription, "/chatter", QoS(1), std::string(bridge_node) + "_3");
  local(EndpointKind::publisher, "/chatter", QoS(1), "n", string_type, 7);
  local(EndpointKind::publisher, "/own", QoS(1), "n", "a_type_of_its_own");
  publisher("/add");
  reader("rt/chatter");
  writer("rt/chatter");
  reader("rt/own");
  remote(Remote::Kind::reader, "rq/addRequest");
  remote(Remote::Kind::reader, "no_ros_topic");
  const Plan nothing = plan();
  EXPECT_THAT(nothing.dds_writers, IsEmpty());
  EXPECT_THAT(nothing.dds_readers, IsEmpty());
  ASSERT_THAT(nothing.unbridged, SizeIs(2));
  EXPECT_EQ(nothing.unbridged[0].topic, "/add");
  EXPECT_EQ(nothing.unbridged[0].why, WhyNot::no_reader);
  EXPECT_EQ(nothing.unbridged[1].topic, "/own");
  EXPECT_EQ(nothing.unbridged[1].why, WhyNot::no_ros_name);
}

}  // namespace
}  // namespace agnocast::bridge
