// SPDX-License-Identifier: Apache-2.0
//
// Goal: the endpoint manager carries a request out as a whole or not at all: it answers, prepares
// the memory that others will touch before they are notified, notifies the processes concerned,
// and believes a process only as far as its packets and its connection go. Method: the daemon's
// core with real regions and doorbells; requests as values; each packet that a process was sent is
// kept.

#include <daemon/lifecycle/endpoint_manager.hpp>
#include <region/views.hpp>
#include <tests/unit/daemon/lifecycle/lifecycle_fixture.hpp>

#include <gtest/gtest.h>

#include <unistd.h>

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::daemon {
namespace {

using wire::Opcode;

class EndpointManagerTest : public LifecycleTest {
 protected:
  using LifecycleTest::LifecycleTest;

  const PublisherRecord& record_of(const EndpointRef& publisher) const {
    return registry.publisher(publisher.topic, publisher.index);
  }
  region::PublisherWords<SharedMemory> words_of(const EndpointRef& publisher) const {
    const PublisherRecord& record = record_of(publisher);
    return {core.regions.region(record.client), record.extent};
  }
  Result<void> leave(ClientIndex client, const EndpointRef& ref) {
    return manager.leave(client, {false, reference(ref)});
  }
  Result<void> drained(ClientIndex client, const EndpointRef& ref) {
    return manager.drained(client, {false, reference(ref)});
  }
  /// Ends a process without endpoints, and frees its place.
  void end(ClientIndex client) {
    registry.client_died(client, journal::DeathReason::died);
    manager.forget_client(client);
    manager.run(manager.endings().free_unused_client(client));
  }
  /// Returns a process in the place that is free next, which has no memory yet.
  ClientIndex successor() { return registry.add_client({1000, 1000, 2, 0, "another"}).value(); }
  /// Returns the bytes from `offset` on that have memory, up to the first hole.
  std::uint64_t backed_bytes(ClientIndex client, std::uint64_t offset) const {
    const auto from = static_cast<off_t>(offset);
    const off_t hole = ::lseek(core.regions.region_reader(client)->get(), from, SEEK_HOLE);
    return hole < from ? 0 : static_cast<std::uint64_t>(hole - from);
  }
};

class OnePublisherATopic : public EndpointManagerTest {
 protected:
  OnePublisherATopic() : EndpointManagerTest({.publishers_per_topic = 1}) {}
};

class FourPublishersATopic : public EndpointManagerTest {
 protected:
  FourPublishersATopic() : EndpointManagerTest({.publishers_per_topic = 4}) {}
};

// --- create

TEST_F(EndpointManagerTest, ACreationIsAnsweredAndThenAnnouncedToItsPeersAlone) {
  const ClientIndex owner = connected_process(), reader = connected_process();
  add(reader, Kind::subscription);
  add(connected_process(), Kind::publisher);
  add(connected_process(), Kind::subscription, "/elsewhere");
  sent.clear();
  const EndpointRef publisher = add(owner, Kind::publisher);
  EXPECT_EQ(lines(), (std::vector<Line>{{owner, Opcode::endpoint_created},
                                        {reader, Opcode::announce},
                                        {owner, Opcode::announce}}));
  const auto answer = sent.at(0).body<wire::EndpointCreated>();
  const PublisherRecord& record = record_of(publisher);
  EXPECT_EQ(answer.header.request, core.last_request);
  EXPECT_EQ(answer.index, publisher.index);
  EXPECT_EQ(answer.generation, record.generation);
  EXPECT_EQ(answer.extent, record.extent);
  EXPECT_EQ(answer.slot_count, record.slot_count);
  EXPECT_EQ(answer.first_sequence, abi::first_sequence_of(record.generation));
}

TEST_F(EndpointManagerTest, ARefusedCreationLeavesNothing) {
  const ClientIndex owner = connected_process(), reader = connected_process();
  CreateRequest asked = core.request(Kind::subscription, "/topic");
  asked.wait_set = 1;  // is not open
  asked.qos.depth = abi::near_slot_count;
  const auto refused = manager.create(reader, asked);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::invalid_argument);
  EXPECT_FALSE(registry.find_topic(0, "/topic")) << "it was made for this endpoint";

  const EndpointRef publisher = add(owner, Kind::publisher);
  const std::uint64_t slot_count = record_of(publisher).slot_count;
  sent.clear();
  EXPECT_FALSE(manager.create(reader, asked));
  EXPECT_EQ(registry.find_topic(0, "/topic"), publisher.topic) << "another process uses it";
  EXPECT_EQ(record_of(publisher).slot_count, slot_count);
  EXPECT_TRUE(registry.endpoints_of(reader).empty());
  EXPECT_TRUE(sent.empty()) << "the caller answers";
}

TEST_F(OnePublisherATopic, ARefusalNamesTheProcessThatKeepsTheTopicFull) {
  const ClientIndex owner = core.process(1), reader = connected_process(2);
  add(reader, Kind::subscription);
  const EndpointRef publisher = add(owner, Kind::publisher);
  ASSERT_TRUE(leave(owner, publisher));
  const auto refused = manager.create(core.process(3), core.request(Kind::publisher, "/topic"));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::limit_reached);
  EXPECT_NE(std::string(detail_of(refused.error())).find("(a process) has not unmapped 1"),
            std::string::npos)
      << detail_of(refused.error());
}

TEST_F(EndpointManagerTest, AnotherTypeIsRefusedAndReportedOnceToEachActiveEndpoint) {
  const ClientIndex owner = connected_process(), reader = connected_process();
  const EndpointRef subscription = add(reader, Kind::subscription);
  const EndpointRef leaves = add(reader, Kind::subscription);
  const EndpointRef publisher = add(owner, Kind::publisher);
  ASSERT_TRUE(leave(reader, leaves));
  CreateRequest asked = core.request(Kind::publisher, "/topic");
  asked.layout_hash = 9;
  const ClientIndex wrong = connected_process();
  sent.clear();
  for (int i = 0; i < 2; ++i) {
    const auto refused = manager.create(wrong, asked);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, Errc::type_mismatch);
    EXPECT_EQ(std::string(detail_of(refused.error())),
              "T (layout 0x0000000000000009) is asked for by process 1, "
              "T (layout 0x0000000000000000) is the type of /topic");
  }
  const auto notices = all<wire::Notice>(Opcode::notice);
  ASSERT_EQ(notices.size(), 2u);
  EXPECT_EQ(sent.size(), 2u);
  EXPECT_EQ(place_in(notices[0]), publisher);
  EXPECT_EQ(place_in(notices[1]), subscription);
  EXPECT_EQ(notices[0].code, static_cast<std::uint32_t>(Errc::type_mismatch));
  EXPECT_FALSE(manager.create(connected_process(), asked));
  EXPECT_EQ(sent.size(), 4u) << "another process is news";
}

TEST_F(EndpointManagerTest, ATypeIsReportedAgainForANewTopicOrProcessInTheSamePlace) {
  const ClientIndex owner = connected_process(), wrong = connected_process();
  CreateRequest asked = core.request(Kind::publisher, "/topic");
  asked.type = "U";
  const auto notices_of_another_try = [&](ClientIndex client) {
    sent.clear();
    EXPECT_FALSE(manager.create(client, asked));
    return all<wire::Notice>(Opcode::notice).size();
  };
  const EndpointRef before = add(owner, Kind::publisher);
  EXPECT_EQ(notices_of_another_try(wrong), 1u);
  EXPECT_EQ(notices_of_another_try(wrong), 0u);
  ASSERT_TRUE(leave(owner, before));
  ASSERT_TRUE(drained(owner, before));
  ASSERT_FALSE(registry.find_topic(0, "/topic"));
  ASSERT_EQ(add(owner, Kind::publisher), before);
  EXPECT_EQ(notices_of_another_try(wrong), 1u);
  EXPECT_EQ(notices_of_another_try(wrong), 0u);
  end(wrong);
  ASSERT_EQ(successor(), wrong);
  EXPECT_EQ(notices_of_another_try(wrong), 1u);
}

TEST_F(EndpointManagerTest, ACreationAskedForAgainIsAnsweredTheSameToItsProcessAlone) {
  const ClientIndex owner = connected_process(), reader = connected_process();
  add(reader, Kind::subscription);
  const CreateRequest asked = core.request(Kind::publisher, "/topic");
  sent.clear();
  core.create(owner, asked);
  const Sent answer = sent.at(0), announcement = sent.at(2);
  const std::uint64_t records = registry.log().committed_lsn();
  sent.clear();
  EXPECT_TRUE(manager.answer_again(owner, asked));
  ASSERT_EQ(count_to(owner), 2u);
  EXPECT_EQ(sent.size(), 2u);
  EXPECT_EQ(sent[0].packet.bytes, answer.packet.bytes);
  EXPECT_EQ(sent[1].packet.bytes, announcement.packet.bytes);
  EXPECT_EQ(registry.log().committed_lsn(), records) << "nothing has changed";
  EXPECT_EQ(registry.counters().requests_answered_again, 1u);

  CreateRequest other = asked;
  other.kind = Kind::subscription;
  EXPECT_FALSE(manager.answer_again(owner, other));
  EXPECT_FALSE(manager.answer_again(reader, asked));
  EXPECT_FALSE(manager.answer_again(owner, core.request(Kind::publisher, "/topic")));
  EXPECT_EQ(sent.size(), 2u);
}

TEST_F(EndpointManagerTest, APublisherFindsItsFirstSequenceAndNothingOfAnEarlierOne) {
  const ClientIndex owner = core.process(1);
  const EndpointRef before = add(owner, Kind::publisher);
  const std::uint64_t extent = record_of(before).extent;
  words_of(before).head().store(abi::pack_entry(1 << 20, 7));
  words_of(before).intent_op().store(abi::intent_publish);
  words_of(before).slot_id(abi::near_slot_count - 1).store(99);
  ASSERT_TRUE(leave(owner, before));
  ASSERT_TRUE(drained(owner, before));
  const EndpointRef publisher = add(owner, Kind::publisher);
  ASSERT_EQ(record_of(publisher).extent, extent);
  EXPECT_EQ(words_of(publisher).head().load(),
            abi::pack_entry(abi::first_sequence_of(record_of(publisher).generation), 0));
  EXPECT_EQ(words_of(publisher).intent_op().load(), 0u);
  EXPECT_EQ(words_of(publisher).slot_id(abi::near_slot_count - 1).load(), 0u);
}

TEST_F(EndpointManagerTest, ReadersHaveMemoryForAllHoldsBeforeAFarPublisherIsAnnounced) {
  const ClientIndex owner = connected_process(), reader = connected_process();
  const EndpointRef subscription = add(reader, Kind::subscription);
  const std::uint64_t extent = registry.subscription(subscription.topic, subscription.index).extent;
  std::uint64_t backed = 0;
  core.channel.on_send = [&](ClientIndex to, const Outgoing&) {
    if (to == owner && backed == 0)
      backed = backed_bytes(reader, extent + abi::link_block_offset(0));
  };
  CreateRequest asked = core.request(Kind::publisher, "/topic");
  asked.qos.depth = abi::near_slot_count;
  const EndpointRef publisher = core.create(owner, asked);
  ASSERT_GT(record_of(publisher).slot_count, std::uint64_t{abi::near_slot_count});
  EXPECT_GE(backed, abi::used_link_bytes(record_of(publisher).slot_count));
  EXPECT_GT(backed, abi::link_part_bytes);
}

TEST_F(EndpointManagerTest, AReaderHasMemoryForTheLinkBlocksWithPublishersAlone) {
  manager.use_wide_topics({"/wide"});
  const ClientIndex owner = core.process(1), reader = core.process(2);
  const auto backed = [&](const EndpointRef& subscription, std::uint64_t block) {
    const std::uint64_t extent =
        registry.subscription(subscription.topic, subscription.index).extent;
    return backed_bytes(reader, extent + abi::link_block_offset(block * abi::link_block_count));
  };
  const EndpointRef earlier = add(reader, Kind::subscription, "/wide");
  EXPECT_EQ(registry.topic(earlier.topic).link_blocks, abi::link_block_max);
  EXPECT_EQ(backed(earlier, 0), 0u);
  for (std::uint32_t i = 0; i < abi::link_block_count; ++i) add(owner, Kind::publisher, "/wide");
  EXPECT_EQ(backed(earlier, 0), abi::link_part_bytes);
  EXPECT_EQ(backed(earlier, 1), 0u);
  CreateRequest deep = core.request(Kind::publisher, "/wide");
  deep.qos.depth = abi::near_slot_count;
  core.create(owner, deep);
  const EndpointRef later = add(reader, Kind::subscription, "/wide");
  for (const EndpointRef& one : {earlier, later}) {
    EXPECT_EQ(backed(one, 0), abi::link_part_bytes);
    EXPECT_EQ(backed(one, 1), 2 * abi::link_part_bytes);
    EXPECT_EQ(backed(one, 2), 0u);
  }
}

TEST_F(EndpointManagerTest, ADeepSubscriptionIsAnsweredWhenAllHaveTheMemoryThatItNeeds) {
  const ClientIndex owner = core.process(1), reader = core.process(2), deep = connected_process(3);
  const EndpointRef publisher = add(owner, Kind::publisher);
  const EndpointRef other = add(reader, Kind::subscription);
  CreateRequest asked = core.request(Kind::subscription, "/topic");
  asked.qos.depth = abi::depth_max;
  std::uint64_t slot_count = 0, of_publisher = 0, of_other = 0, of_deep = 0;
  core.channel.on_send = [&](ClientIndex, const Outgoing& packet) {
    const Sent one{deep, packet};
    if (one.opcode() != Opcode::endpoint_created) return;
    slot_count = record_of(publisher).slot_count;
    of_publisher = backed_bytes(owner, record_of(publisher).extent);
    const auto links = abi::link_block_offset(0);
    of_other = backed_bytes(reader, registry.subscription(other.topic, other.index).extent + links);
    of_deep = backed_bytes(deep, one.body<wire::EndpointCreated>().extent + links);
  };
  core.create(deep, asked);
  EXPECT_GT(slot_count, std::uint64_t{abi::near_slot_count});
  EXPECT_GE(of_publisher, abi::slot_offset(abi::ring_count, slot_count));
  EXPECT_GE(of_other, abi::used_link_bytes(slot_count));
  EXPECT_GE(of_deep, abi::used_link_bytes(slot_count));
}

TEST_F(EndpointManagerTest, OnlyHoldsOfOtherUsersMessagesComeFromThePool) {
  const ClientIndex reader = core.process(1);
  const HoldPool pool = registry.hold_pool();
  for (const bool or_less : {false, true}) {
    CreateRequest asked = core.request(Kind::subscription, or_less ? "/less" : "/all");
    asked.quota = 1000;
    asked.quota_or_less = or_less;
    const EndpointRef ref = core.create(reader, asked);
    const SubscriptionRecord& record = registry.subscription(ref.topic, ref.index);
    EXPECT_EQ(record.quota, 1000u);
    EXPECT_EQ(record.quota_of_others, or_less ? pool.part({}, 1000) : pool.at_most({}));
  }
}

// --- the end of endpoints

TEST_F(EndpointManagerTest, APublisherLeavesWithTheHeadInItsOwnMemory) {
  const ClientIndex owner = connected_process(), reader = connected_process();
  add(reader, Kind::subscription);
  const EndpointRef publisher = add(owner, Kind::publisher);
  const std::uint64_t head = words_of(publisher).head().load() + abi::pack_entry(3, 0);
  words_of(publisher).head().store(head);
  sent.clear();
  const auto refused = leave(reader, publisher);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::protocol_violation);
  EXPECT_EQ(record_of(publisher).state, EndpointState::active);
  EXPECT_TRUE(sent.empty());

  wire::Reference own = reference(publisher);
  own.header.request = 42;
  ASSERT_TRUE(manager.leave(owner, {false, own}));
  EXPECT_EQ(lines(), (std::vector<Line>{{reader, Opcode::orphaned}, {owner, Opcode::done}}));
  EXPECT_EQ(sent.at(0).body<wire::Orphaned>().final_head, head);
  EXPECT_EQ(sent.at(1).body<wire::Done>().header.request, 42u);
  EXPECT_EQ(registry.final_head_of(publisher.topic, publisher.index), head);
}

TEST_F(EndpointManagerTest, APlaceIsFreeAfterItsPeersHaveUnmappedItAndItsProcessHasDrained) {
  const ClientIndex owner = connected_process(), reader = connected_process();
  const EndpointRef subscription = add(reader, Kind::subscription);
  const std::uint64_t before = packets_to(reader);
  const EndpointRef publisher = add(owner, Kind::publisher);
  ASSERT_TRUE(leave(owner, publisher));
  sent.clear();
  EXPECT_FALSE(drained(owner, publisher)) << "a reader has it";
  auto former = unlinked(publisher, packets_to(reader)), elsewhere = former;
  --former.generation;
  elsewhere.topic = abi::topic_count_max - 1;
  for (const wire::Unlinked& statement : {former, elsewhere, unlinked(publisher, before)}) {
    EXPECT_TRUE(manager.unlinked(reader, statement)) << "late, but no mistake";
  }
  EXPECT_FALSE(manager.unlinked(reader, unlinked(publisher, packets_to(reader) + 1)));
  EXPECT_TRUE(is_notified(publisher, reader));
  EXPECT_TRUE(sent.empty());

  ASSERT_TRUE(manager.unlinked(reader, unlinked(publisher, packets_to(reader))));
  EXPECT_EQ(lines(), (std::vector<Line>{{owner, Opcode::kick}}));
  EXPECT_EQ(record_of(publisher).state, EndpointState::over);
  EXPECT_TRUE(is_notified(subscription, owner));
  ASSERT_TRUE(drained(owner, publisher));
  EXPECT_FALSE(registry.is_used(publisher));
  EXPECT_FALSE(is_notified(subscription, owner)) << "it had no other publisher there";

  ASSERT_TRUE(leave(reader, subscription));
  ASSERT_TRUE(drained(reader, subscription));
  EXPECT_FALSE(registry.find_topic(0, "/topic"));
}

TEST_F(EndpointManagerTest, ARegionIsAcknowledgedOnlyAfterTheWholeWelcomeOfItsReader) {
  const ClientIndex owner = core.process(1), reader = connected_process();
  add(reader, Kind::subscription);
  const EndpointRef publisher = add(owner, Kind::publisher);
  ASSERT_TRUE(leave(owner, publisher));
  ASSERT_TRUE(manager.unlinked(reader, unlinked(publisher, packets_to(reader))));
  core.channel.keeps_output = true;
  Session& session = connect_slowly(reader);
  manager.welcome_back(reader);
  ASSERT_TRUE(manager.is_announcing());
  ASSERT_TRUE(manager.unlinked(reader, region_unlinked(owner, packets_to(reader))));
  EXPECT_TRUE(registry.client(owner).notified.contains(number(reader)));
  for (int packets = 0; manager.is_announcing(); ++packets) {
    ASSERT_LT(packets, 100);
    session.drop_output();
    manager.go_on_announcing();
  }
  ASSERT_EQ(sent.back().opcode(), Opcode::region) << "so the process states it once more";
  ASSERT_TRUE(manager.unlinked(reader, region_unlinked(owner, packets_to(reader))));
  EXPECT_FALSE(registry.client(owner).notified.contains(number(reader)));
}

// --- doorbells that have changed

TEST_F(EndpointManagerTest, NewDoorbellsAreAnnouncedOnceToThePublishersOfTheirSubscriptions) {
  const ClientIndex first = connected_process(), second = connected_process();
  const ClientIndex reader = connected_process();
  ASSERT_TRUE(core.doorbells.open(reader, 1, 0));
  add(first, Kind::publisher);
  add(second, Kind::publisher);
  add(second, Kind::publisher, "/elsewhere");
  add(reader, Kind::subscription);
  CreateRequest asked = core.request(Kind::subscription, "/topic");
  asked.wait_set = 1;
  const EndpointRef subscription = core.create(reader, asked);
  sent.clear();
  manager.renewed(reader, 1);
  manager.renewed(reader, 1);
  EXPECT_TRUE(manager.has_renewed());
  manager.announce_renewed();
  EXPECT_FALSE(manager.has_renewed());
  manager.announce_renewed();
  EXPECT_EQ(lines(), (std::vector<Line>{{first, Opcode::announce}, {second, Opcode::announce}}));
  for (const auto& packet : all<wire::Announcement>(Opcode::announce))
    EXPECT_EQ(place_in(packet), subscription);
}

TEST_F(EndpointManagerTest, NewDoorbellsOfASubscriptionThatIsOverAreNotAnnounced) {
  const ClientIndex owner = connected_process(), reader = core.process(1), other = core.process(1);
  const EndpointRef publisher = add(owner, Kind::publisher);
  const EndpointRef subscription = add(reader, Kind::subscription);
  manager.renewed(reader, 0);
  ASSERT_TRUE(leave(reader, subscription));
  ASSERT_TRUE(drained(reader, subscription));
  ASSERT_TRUE(manager.unlinked(owner, unlinked(subscription, packets_to(owner))));
  ASSERT_EQ(add(other, Kind::subscription), subscription) << "another one has its place";
  ASSERT_TRUE(registry.is_used(publisher));
  sent.clear();
  manager.announce_renewed();
  EXPECT_TRUE(sent.empty());
  EXPECT_FALSE(manager.has_renewed());
}

TEST_F(EndpointManagerTest, NewDoorbellsAreAnnouncedInParts) {
  const ClientIndex owner = connected_process(), reader = core.process(1);
  add(owner, Kind::publisher);
  constexpr std::size_t count = 201;
  for (std::size_t i = 0; i < count; ++i) add(reader, Kind::subscription);
  sent.clear();
  manager.renewed(reader, 0);
  manager.announce_renewed();
  const std::size_t part = sent.size();
  EXPECT_LT(part, count);
  EXPECT_GT(part, 0u);
  while (manager.has_renewed()) manager.announce_renewed();
  EXPECT_EQ(sent.size(), count);
}

// --- the end of processes and of daemons

TEST_F(EndpointManagerTest, AProcessIsNotSentTheNoticesOfTheOneThatHadItsPlace) {
  const ClientIndex owner = core.process(1);
  std::vector<ClientIndex> freed;
  manager.on_client_freed = [&](ClientIndex client) { freed.push_back(client); };
  const EndpointRef publisher = add(owner, Kind::publisher);
  manager.notice(publisher, Errc::type_mismatch, "it has no connection");
  ASSERT_TRUE(leave(owner, publisher));
  ASSERT_TRUE(drained(owner, publisher));
  end(owner);
  EXPECT_EQ(freed, std::vector{owner});
  ASSERT_EQ(successor(), owner);
  connect(owner);
  manager.welcome_back(owner);
  EXPECT_TRUE(sent.empty());
}

// The former daemon died between a record and those that follow from it.
TEST_F(EndpointManagerTest, ADaemonThatContinuesMakesUpForWhatTheFormerOneOwed) {
  const ClientIndex owner = core.process(1), reader = core.process(2), gone = core.process(3);
  std::vector<ClientIndex> freed;
  manager.on_client_freed = [&](ClientIndex client) { freed.push_back(client); };
  const EndpointRef publisher = add(owner, Kind::publisher);
  const EndpointRef subscription = add(reader, Kind::subscription);
  registry.change_subscription(subscription.topic, subscription.index, EndpointState::over);
  const EndpointRef unread = add(owner, Kind::publisher, "/unread");
  registry.orphan_publisher(unread.topic, unread.index, 0);
  ASSERT_TRUE(registry.add_topic({0, "/empty", "T", 0}));
  const EndpointRef alone = add(reader, Kind::subscription, "/alone");
  registry.change_subscription(alone.topic, alone.index, EndpointState::over);
  registry.client_died(gone, journal::DeathReason::died);
  registry.client_forgotten(gone);

  manager.carry_out_what_is_owed();
  EXPECT_FALSE(is_notified(publisher, reader)) << "it has drained its only subscription there";
  EXPECT_EQ(record_of(publisher).state, EndpointState::active);
  EXPECT_TRUE(registry.is_used(subscription)) << "the publisher's process has it";
  EXPECT_EQ(record_of(unread).state, EndpointState::over) << "its process has to drain";
  EXPECT_FALSE(registry.find_topic(0, "/empty"));
  EXPECT_FALSE(registry.find_topic(0, "/alone"));
  EXPECT_EQ(freed, std::vector{gone});
}

TEST_F(FourPublishersATopic, ADaemonThatContinuesGivesUpTheOldestOrphansThatItCannotFree) {
  const ClientIndex owner = core.process(1), reader = core.process(2);
  add(reader, Kind::subscription);
  std::vector<EndpointRef> publishers;
  for (int i = 0; i < 4; ++i) publishers.push_back(add(owner, Kind::publisher));
  for (const EndpointRef& ref : publishers) registry.orphan_publisher(ref.topic, ref.index, 0);
  registry.acknowledge_unmap(publishers[3], reader);
  manager.carry_out_what_is_owed();
  const auto& given_up = manager.endings().given_up();
  ASSERT_EQ(given_up.size(), 1u);
  ASSERT_EQ(given_up.at(1).size(), 1u) << "the last one is over, and half of the places may wait";
  EXPECT_EQ(given_up.at(1).begin()->second, publishers[0]);
}

}  // namespace
}  // namespace agnocast::daemon
