// SPDX-License-Identifier: Apache-2.0
//
// Goal: indexes, extents and generations are assigned by the rules (lowest free; never one that a
// process may still know), the board agrees with the tables, and a restarted daemon finds
// everything in the memory of the previous one, whatever it was doing when it died. Method: the
// registry over anonymous memory; seeded random operations against a trivial reference model; a
// death simulated at every record by leaving it committed and not applied.

#include <tests/unit/daemon/state/registry_fixture.hpp>

namespace agnocast::daemon {
namespace {

TEST_F(RegistryTest, AssignsLowestIndexesAndFreshGenerations) {
  const ClientIndex a = client(), b = client();
  EXPECT_EQ(number(a), 0u);
  EXPECT_EQ(number(b), 1u);
  const TopicIndex t = topic();
  const auto p = publisher(a, t), q = publisher(b, t);
  EXPECT_EQ(p.index, 0u);
  EXPECT_EQ(q.index, 1u);
  EXPECT_GT(q.generation, p.generation);
  EXPECT_EQ(p.extent, abi::page_bytes);
  EXPECT_EQ(q.extent, abi::page_bytes) << "every process has its own region";
  EXPECT_EQ(abi::generation_of(publisher_word(t, 0)), p.generation);
  EXPECT_EQ(abi::state_of(publisher_word(t, 1)), abi::BoardState::active);
}

TEST_F(RegistryTest, ReusesAnIndexOnlyWhenNoProcessKnowsTheOldOne) {
  const ClientIndex a = client(), b = client();
  const TopicIndex t = topic();
  const auto p = publisher(a, t);
  const EndpointRef ref{Kind::publisher, t, p.index};
  registry.notify(ref, b);
  EXPECT_TRUE(registry.client(a).notified.contains(number(b))) << "b knows its region as well";
  registry.orphan_publisher(t, p.index, abi::pack_entry(p.first_sequence, 0));
  EXPECT_EQ(publisher(a, t).index, 1u);
  registry.acknowledge_unmap(ref, b);
  registry.end_publisher(t, p.index, EndpointState::over);
  EXPECT_EQ(abi::state_of(publisher_word(t, 0)), abi::BoardState::free);
  EXPECT_EQ(publisher(a, t).index, 2u) << "its own process still uses the extent";
  registry.end_publisher(t, p.index, EndpointState::free);
  const auto again = publisher(a, t);
  EXPECT_EQ(again.index, 0u);
  EXPECT_EQ(again.extent, p.extent);
  EXPECT_GT(again.generation, p.generation);
}

TEST_F(RegistryTest, KeepsExtentsApart) {
  const ClientIndex a = client();
  const TopicIndex t = topic();
  const auto p = publisher(a, t);
  const auto s = subscription(a, t);
  const auto q = publisher(a, t);
  EXPECT_EQ(s.extent, p.extent + abi::publisher_extent_bytes);
  EXPECT_EQ(q.extent, s.extent + abi::subscription_extent_bytes(1));
  registry.change_subscription(t, s.index, EndpointState::over);
  registry.free_subscription(t, s.index);
  const TopicIndex wide = registry.add_topic({0, "/wide", "T", 5, abi::link_block_max}).value();
  EXPECT_EQ(subscription(a, wide).extent, q.extent + abi::publisher_extent_bytes)
      << "it does not fit into the extent of the other one";
  EXPECT_EQ(subscription(a, t).extent, s.extent);
}

TEST_F(RegistryTest, RaisesSlotsBeforeADeepSubscriptionJoins) {
  const ClientIndex a = client();
  const TopicIndex t = topic();
  const auto p = publisher(a, t, 1);
  EXPECT_EQ(p.slot_count, abi::near_slot_count);
  const abi::Qos qos{500, false, true, false, false};
  const auto plan = registry.plan_subscription(a, t, qos, {100, 1}).value();
  ASSERT_EQ(plan.raises.size(), 1u);
  EXPECT_EQ(plan.raises[0].slot_count, 640u);  // 500 + 100 + 34, whole words
  for (int i = 0; i < 3; ++i) publisher(a, t, 1);
  EXPECT_EQ(registry.plan_subscription(a, t, qos, {100, 1}).value().raises.size(), 4u)
      << "they need the same";
  const ClientIndex of_another = client(7);
  publisher(of_another, t, 1);
  const auto raises = registry.plan_subscription(a, t, qos, {100, 1}).value().raises;
  EXPECT_EQ(raises.back().slot_count, 576u);  // 500 + 1 + 34, whole words
  abi::Qos ignoring = qos;
  ignoring.ignore_local = true;
  EXPECT_EQ(registry.plan_subscription(a, t, ignoring, {100, 1}).value().raises.size(), 1u)
      << "of other processes only";
  registry.raise_slots(t, plan.raises[0]);
  EXPECT_EQ(
      board_word(t, abi::publisher_entry_offset(0) + offsetof(abi::PublisherEntry, slot_count)),
      640u);
  EXPECT_EQ(registry.slots_by_link_block(t)[0], 640u);
  registry.add_subscription(a, t, qos, {100, 1}, 0, plan, "node");
  EXPECT_EQ(publisher(a, t, 1).slot_count, 640u);
}

TEST_F(RegistryTest, NeverPlansMoreSlotsThanThereAre) {
  const ClientIndex a = client();
  const TopicIndex t = topic();
  for (int i = 0; i < 5; ++i) subscription(a, t, 1000, 1000);
  EXPECT_EQ(publisher(a, t, 1000).slot_count, abi::slot_count_max);
}

TEST_F(RegistryTest, CountsPerUser) {
  const ClientIndex a = client(1), b = client(1), c = client(2);
  const TopicIndex t = topic();
  publisher(a, t);
  subscription(b, t, 1, 7);
  subscription(c, t);
  registry.open_window(a, {0x1000, 4096, 0});
  registry.open_wait_set(b, 0);
  registry.open_wait_set(b, 5);
  const Usage usage = registry.accounts().usage_of(1);
  EXPECT_EQ(usage.clients, 2u);
  EXPECT_EQ(usage.publishers, 1u);
  EXPECT_EQ(usage.subscriptions, 1u);
  EXPECT_EQ(usage.wait_sets, 2u);
  EXPECT_EQ(usage.windows, 1u);
  EXPECT_EQ(usage.heap_bytes, 4096u);
  EXPECT_EQ(usage.held_messages, 7u);
  EXPECT_EQ(usage.topics, 1u);
  EXPECT_EQ(registry.accounts().usage_of(3).clients, 0u);
}

TEST_F(RegistryTest, EndsAProcessOnlyWhenNoOtherProcessKnowsPartOfIt) {
  const ClientIndex a = client(), b = client();
  const TopicIndex t = topic();
  const auto p = publisher(a, t);
  registry.notify({Kind::publisher, t, p.index}, b);
  EXPECT_FALSE(registry.can_free(a));
  registry.client_died(a, journal::DeathReason::died);
  registry.orphan_publisher(t, p.index, 0);
  EXPECT_FALSE(registry.can_free(a));
  registry.acknowledge_unmap({Kind::publisher, t, p.index}, b);
  registry.end_publisher(t, p.index, EndpointState::free);
  EXPECT_FALSE(registry.can_free(a)) << "b still maps its region";
  registry.acknowledge_region_unmap(a, b);
  EXPECT_FALSE(registry.can_free(a)) << "it still counts as notified of others' endpoints";
  registry.client_forgotten(a);
  EXPECT_TRUE(registry.can_free(a));
  const std::uint64_t generation = registry.client(a).generation;
  registry.free_client(a);
  EXPECT_EQ(client(), a);
  EXPECT_GT(registry.client(a).generation, generation);
}

TEST_F(RegistryTest, ForgetsADeadProcessEverywhere) {
  const ClientIndex a = client(), b = client();
  const TopicIndex t = topic(), u = topic("/other");
  const auto p = publisher(a, t);
  const auto s = subscription(a, u);
  registry.notify({Kind::publisher, t, p.index}, b);
  registry.notify({Kind::subscription, u, s.index}, b);
  registry.client_died(b, journal::DeathReason::died);
  EXPECT_EQ(registry.known_topic_of(b), t);
  registry.acknowledge_topic(b, t);
  EXPECT_EQ(registry.known_topic_of(b), u);
  registry.acknowledge_topic(b, u);
  EXPECT_FALSE(registry.known_topic_of(b));
  EXPECT_TRUE(registry.client(a).notified.contains(number(b))) << "its region is forgotten last";
  registry.client_forgotten(b);
  EXPECT_TRUE(registry.notified_of({Kind::publisher, t, p.index}).reusable());
  EXPECT_TRUE(registry.notified_of({Kind::subscription, u, s.index}).reusable());
  EXPECT_TRUE(registry.client(a).notified.reusable());
}

TEST_F(RegistryTest, FreesATopicWithItsLastEndpointAndThenAcceptsAnotherType) {
  const ClientIndex a = client();
  const TopicIndex t = topic();
  const auto s = subscription(a, t);
  EXPECT_FALSE(registry.topic_is_empty(t));
  registry.change_subscription(t, s.index, EndpointState::over);
  registry.free_subscription(t, s.index);
  ASSERT_TRUE(registry.topic_is_empty(t));
  const std::uint64_t epoch = board_word(t, offsetof(abi::TopicHeader, epoch));
  registry.free_topic(t);
  EXPECT_FALSE(registry.find_topic(0, "/topic"));
  const TopicIndex again = registry.add_topic({0, "/topic", "pkg/msg/Other", 6}).value();
  EXPECT_EQ(again, t);
  EXPECT_STREQ(registry.topic(again).type, "pkg/msg/Other");
  EXPECT_GE(board_word(t, offsetof(abi::TopicHeader, epoch)), epoch) << "an epoch never decreases";
}

TEST_F(RegistryTest, KeepsDomainsApart) {
  const TopicIndex t = topic();
  EXPECT_FALSE(registry.find_topic(1, "/topic"));
  const TopicIndex other = registry.add_topic({1, "/topic", "pkg/msg/Other", 6}).value();
  EXPECT_NE(t, other);
  EXPECT_EQ(registry.find_topic(1, "/topic"), other);
}

TEST_F(RegistryTest, ReportsAFullTable) {
  const ClientIndex a = client();
  const auto refusal = [&](TopicIndex at) {
    const auto full = registry.plan_publisher(a, at, {1, false, true, false, false});
    EXPECT_EQ(full.error().code, Errc::limit_reached);
    return std::string(detail_of(full.error()));
  };
  const TopicIndex narrow = topic();
  for (std::uint32_t i = 0; i < abi::link_block_count; ++i) publisher(a, narrow);
  EXPECT_EQ(refusal(narrow),
            "the topic has 256 publishers, as many as one that began without being in [limits] "
            "wide_topics may have");
  const TopicIndex wide = registry.add_topic({0, "/wide", "T", 5, abi::link_block_max}).value();
  for (std::uint32_t i = 0; i < abi::publisher_count_max; ++i) publisher(a, wide);
  EXPECT_EQ(refusal(wide), "[limits] publishers_per_topic is 2048, as many are there");
  for (std::uint32_t i = 1; i < abi::client_count_max; ++i) client();
  const auto no_client = registry.add_client({0, 0, 0, 0, ""});
  ASSERT_FALSE(no_client);
  EXPECT_EQ(no_client.error().code, Errc::limit_reached);
}

TEST_F(RegistryTest, ASubscriptionOfAWideTopicHasAllLinkBlocks) {
  const ClientIndex a = client();
  const TopicIndex wide = registry.add_topic({0, "/wide", "T", 5, abi::link_block_max}).value();
  const auto s = subscription(a, wide);
  const auto next = subscription(a, wide);
  EXPECT_EQ(next.extent, s.extent + abi::subscription_extent_bytes(abi::link_block_max));
  for (std::uint32_t i = 0; i <= abi::link_block_count; ++i) publisher(a, wide, 1);
  publisher(a, wide, 1000);
  const LinkBlocks slots = registry.slots_by_link_block(wide);
  EXPECT_EQ(slots[0], abi::near_slot_count);
  EXPECT_GT(slots[1], 1000u);
  EXPECT_EQ(slots[2], 0u);
  Registry later(memory.parts());
  ASSERT_TRUE(later.open());
  EXPECT_EQ(later.topic(wide).link_blocks, abi::link_block_max);
  EXPECT_EQ(later.slots_by_link_block(wide), slots);
}

TEST_F(RegistryTest, IsFoundAgainAfterARestart) {
  const ClientIndex a = client(), b = client();
  const TopicIndex t = topic();
  const auto p = publisher(a, t);
  registry.notify({Kind::publisher, t, p.index}, b);
  Registry later(memory.parts());
  ASSERT_TRUE(later.open());
  EXPECT_EQ(later.find_topic(0, "/topic"), t);
  EXPECT_EQ(later.endpoints_of(a).size(), 1u);
  EXPECT_TRUE(later.notified_of({Kind::publisher, t, 0}).contains(number(b)));
  const auto q = later.plan_publisher(a, t, {1, false, true, false, false}).value();
  EXPECT_EQ(q.index, 1u);
  EXPECT_EQ(q.extent, p.extent + abi::publisher_extent_bytes);
  EXPECT_GT(q.generation, p.generation);
}

TEST_F(RegistryTest, RefusesMemoryOfAnotherLayoutAndNamesBoth) {
  client();
  auto& fingerprint = SharedMemory::word(memory.parts().log, 8);
  fingerprint.store(0x1234);
  const auto opened = Registry(memory.parts()).open();
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().code, Errc::layout_mismatch);
  const std::string text = detail_of(opened.error());
  EXPECT_NE(text.find("0x0000000000001234"), std::string::npos) << text;
  char own[32];
  std::snprintf(own, sizeof own, "0x%016llx", static_cast<unsigned long long>(abi::fingerprint()));
  EXPECT_NE(text.find(own), std::string::npos) << text;
  // The layout of the tables may differ although that of the regions is equal.
  fingerprint.store(abi::fingerprint());
  ASSERT_TRUE(Registry(memory.parts()).open());
  SharedMemory::word(memory.parts().tables, offsetof(TableHeader, layout)).store(7);
  const auto tables = Registry(memory.parts()).open();
  ASSERT_FALSE(tables);
  EXPECT_EQ(tables.error().code, Errc::layout_mismatch);
}

TEST_F(RegistryTest, RefusesDamageAndDescribesIt) {
  const ClientIndex a = client();
  const TopicIndex t = topic();
  publisher(a, t);
  const auto refused_with = [&](auto damage, const char* what) {
    const std::vector<std::byte> log(memory.parts().log,
                                     memory.parts().log + journal::RedoLog::bytes);
    const Tables& tables = *reinterpret_cast<Tables*>(memory.parts().tables);
    const TableHeader header = tables.header;
    const ClientRecord first_client = tables.client[0];
    const TopicRecord first_topic = tables.topic[0];
    const PublisherRecord first_publisher = tables.publisher[0][0];
    damage();
    const auto opened = Registry(memory.parts()).open();
    EXPECT_FALSE(opened) << what;
    if (!opened) {
      EXPECT_EQ(opened.error().code, Errc::store_damaged);
      EXPECT_NE(std::string(detail_of(opened.error())).find(what), std::string::npos)
          << detail_of(opened.error());
    }
    std::memcpy(memory.parts().log, log.data(), log.size());
    Tables& mended = *reinterpret_cast<Tables*>(memory.parts().tables);
    mended.header = header;
    mended.client[0] = first_client;
    mended.topic[0] = first_topic;
    mended.publisher[0][0] = first_publisher;
    ASSERT_TRUE(Registry(memory.parts()).open());
  };
  const auto log_word = [&](std::uint64_t offset) -> abi::SharedWord& {
    return SharedMemory::word(memory.parts().log, offset);
  };
  Tables& tables = *reinterpret_cast<Tables*>(memory.parts().tables);
  refused_with([&] { log_word(0).store(1); }, "has no valid header");
  refused_with([&] { log_word(128).store(log_word(64).load() + 1); }, "contradict each other");
  refused_with([&] { log_word(128).store(log_word(64).load() - 2); }, "contradict each other");
  refused_with(
      [&] {
        const std::uint64_t committed = log_word(64).load();
        log_word(128).store(committed - 1);
        log_word(4096 + committed * sizeof(journal::Record) + 40).fetch_xor(1);
      },
      "last record of the redo log is not whole");
  refused_with([&] { tables.header.magic = 0; }, "do not begin like tables");
  refused_with([&] { tables.header.client_high = abi::client_count_max + 1; }, "out of range");
  refused_with([&] { tables.client[0].window_count = 99; }, "windows of a process");
  refused_with([&] { tables.client[0].state = static_cast<ClientState>(9); }, "state of a process");
  refused_with([&] { tables.publisher[0][0].extent = abi::client_region_bytes; }, "a publisher");
  refused_with([&] { tables.publisher[0][0].client = ClientIndex{77}; }, "a publisher");
  refused_with([&] { tables.publisher[0][0].state = EndpointState::free; }, "a publisher");
  refused_with([&] { tables.topic[0].subscriptions[3] = 1; }, "places of a topic");
  refused_with([&] { tables.topic[0].link_blocks = 0; }, "link blocks of a topic");
  refused_with([&] { tables.topic[0].link_blocks = 9; }, "link blocks of a topic");
  refused_with([&] { tables.topic[0].publisher_high = abi::link_block_count + 1; },
               "link blocks of a topic");
  refused_with([&] { log_word(16).store(2); }, "are of different incarnations");
}

TEST_F(RegistryTest, AssignsNoFreePlaceThatAProcessIsStillNotifiedOf) {
  const ClientIndex a = client();
  const TopicIndex t = topic();
  const abi::Qos qos{1, false, true, false, false};
  publisher(a, t);
  subscription(a, t);
  Tables& tables = *reinterpret_cast<Tables*>(memory.parts().tables);
  tables.publisher[number(t)][1].notified.notify(5);
  tables.subscription[number(t)][1].notified.notify(5);
  const auto of_publisher = registry.plan_publisher(a, t, qos);
  ASSERT_FALSE(of_publisher);
  EXPECT_EQ(of_publisher.error().code, Errc::store_damaged);
  const auto of_subscription = registry.plan_subscription(a, t, qos, {1, 1});
  ASSERT_FALSE(of_subscription);
  EXPECT_EQ(of_subscription.error().code, Errc::store_damaged);
  // A place that was used before is skipped.
  const EndpointRef ref{Kind::subscription, t, 0};
  registry.change_subscription(t, 0, EndpointState::over);
  registry.free_subscription(t, 0);
  tables.subscription[number(t)][1].notified.acknowledge(5, 0);
  tables.subscription[number(t)][0].notified.notify(5);
  EXPECT_FALSE(registry.is_used(ref));
  EXPECT_EQ(registry.plan_subscription(a, t, qos, {1, 1}).value().index, 1u);
}

/// Returns the number of pages of the tables that have memory.
std::uint64_t pages_of(const Registry::Memory& memory) {
  const auto page = static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
  std::vector<unsigned char> there(tables_bytes / page);
  EXPECT_EQ(::mincore(memory.tables, there.size() * page, there.data()), 0);
  return static_cast<std::uint64_t>(
      std::count_if(there.begin(), there.end(), [](unsigned char one) { return (one & 1) != 0; }));
}

// Places that were used once cost nothing, whichever process had them and wherever they lie.
TEST_F(RegistryTest, ReturnsTheMemoryOfFreePlaces) {
  const ClientIndex a = client();
  std::vector<TopicIndex> topics;
  for (int i = 0; i < 3; ++i) topics.push_back(topic("/topic" + std::to_string(i)));
  subscription(a, topics[0]);
  publisher(a, topics[0]);
  const std::uint64_t before = pages_of(memory.parts());
  for (const TopicIndex at : topics) {
    while (registry.topic(at).subscription_high < abi::subscription_count_max) subscription(a, at);
    while (registry.topic(at).publisher_high < abi::link_block_count) publisher(a, at);
  }
  const std::uint64_t full = pages_of(memory.parts());
  EXPECT_GT(full, before + 300);
  const auto end = [&](const EndpointRef& ref) {
    if (ref.kind == Kind::publisher) {
      registry.orphan_publisher(ref.topic, ref.index, 0);
      registry.end_publisher(ref.topic, ref.index, EndpointState::over);
      registry.end_publisher(ref.topic, ref.index, EndpointState::free);
    } else {
      registry.change_subscription(ref.topic, ref.index, EndpointState::over);
      registry.free_subscription(ref.topic, ref.index);
    }
  };
  // The first topic keeps its first and last places: the memory between them is returned too.
  const auto is_kept = [&](const EndpointRef& ref) {
    const std::uint32_t last =
        ref.kind == Kind::publisher ? abi::link_block_count - 1 : abi::subscription_count_max - 1;
    return ref.topic == topics[0] && (ref.index == 0 || ref.index == last);
  };
  for (const EndpointRef& ref : std::vector(registry.endpoints_of(a))) {
    if (!is_kept(ref)) end(ref);
  }
  for (const std::size_t i : {1u, 2u}) registry.free_topic(topics[i]);
  // A page for each of two places, and two for a place that lies in both.
  EXPECT_LE(pages_of(memory.parts()), before + 6);
  // No code reads missing places: no walk, no answer to a request that names one, no start.
  const std::uint64_t after = pages_of(memory.parts());
  EXPECT_FALSE(registry.is_used({Kind::subscription, topics[0], 300}));
  EXPECT_FALSE(registry.is_used({Kind::subscription, topics[0], 1u << 31}));
  EXPECT_FALSE(registry.is_used({Kind::publisher, topics[1], 3}));
  std::vector<std::uint32_t> met;
  registry.for_each_subscription(
      topics[0], [&](std::uint32_t i, const SubscriptionRecord&) { met.push_back(i); });
  EXPECT_EQ(met, (std::vector<std::uint32_t>{0, abi::subscription_count_max - 1}));
  Registry later(memory.parts());
  ASSERT_TRUE(later.open());
  EXPECT_EQ(later.repair_board(), 0u);
  EXPECT_EQ(later.endpoints_of(a).size(), 4u);
  EXPECT_EQ(pages_of(memory.parts()), after);
  // A place that is assigned again is as if new.
  const auto again =
      later.plan_subscription(a, topics[0], {1, false, true, false, false}, {1, 1}).value();
  EXPECT_EQ(again.index, 1u);
}

TEST_F(RegistryTest, VisitsEndpointsEvenIfTheyEndMeanwhile) {
  const ClientIndex a = client();
  const TopicIndex t = topic();
  for (int i = 0; i < 130; ++i) subscription(a, t);
  std::vector<std::uint32_t> met;
  registry.for_each_subscription(t, [&](std::uint32_t i, const SubscriptionRecord&) {
    met.push_back(i);
    for (const std::uint32_t one : {i, i + 1}) {
      if (!registry.is_used({Kind::subscription, t, one})) continue;
      registry.change_subscription(t, one, EndpointState::over);
      registry.free_subscription(t, one);
    }
  });
  EXPECT_EQ(met.size(), 65u);
  EXPECT_TRUE(registry.topic_is_empty(t));
}

}  // namespace
}  // namespace agnocast::daemon
