// SPDX-License-Identifier: Apache-2.0
//
// Goal: indexes, extents and generations are given out by the rules (lowest free; never one that
// somebody may still know), the board says what the tables say, and a second life of the daemon
// finds everything in the memory of the first, whatever it died in.
// Method: the registry over anonymous memory; seeded random operations against a trivial reference
// model; a death simulated at every record by leaving it committed and not applied.

#include <agnocast/abi/fingerprint.hpp>
#include <daemon/state/registry.hpp>
#include <tests/support/registry_memory.hpp>

#include <gtest/gtest.h>

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cstdio>
#include <cstring>
#include <map>
#include <random>
#include <set>

namespace agnocast::daemon {
namespace {

using Memory = test::RegistryMemory;

class RegistryTest : public testing::Test {
 protected:
  RegistryTest() : registry(memory.parts()) { registry.create(1); }

  ClientIndex client(std::uint32_t uid = 1000) {
    return registry.add_client({uid, uid, 1, 0, "a process"}).value();
  }
  TopicIndex topic(std::string_view name = "/topic") {
    return registry.add_topic({0, name, "pkg/msg/Type", 5}).value();
  }
  PublisherPlan publisher(ClientIndex owner, TopicIndex at, std::uint32_t depth = 1) {
    const abi::Qos qos{depth, false, true, false, false};
    const PublisherPlan plan = registry.plan_publisher(owner, at, qos).value();
    registry.add_publisher(owner, at, qos, plan, "node");
    return plan;
  }
  SubscriptionPlan subscription(ClientIndex owner, TopicIndex at, std::uint32_t depth = 1,
                                std::uint64_t own_quota = 1, std::uint64_t quota_of_others = 1) {
    const abi::Qos qos{depth, false, true, false, false};
    const HoldQuota quota{own_quota, quota_of_others};
    const SubscriptionPlan plan = registry.plan_subscription(owner, at, qos, quota).value();
    for (const SlotRaise& raise : plan.raises) registry.raise_slots(at, raise);
    registry.add_subscription(owner, at, qos, quota, 0, plan, "node");
    return plan;
  }
  std::uint64_t board_word(TopicIndex at, std::uint64_t offset) const {
    return SharedMemory::word(memory.board(), abi::topic_offset(number(at)) + offset).load();
  }
  std::uint64_t publisher_word(TopicIndex at, std::uint32_t index) const {
    return board_word(at, abi::publisher_entry_offset(index));
  }
  std::uint64_t subscription_word(TopicIndex at, std::uint32_t index) const {
    return board_word(at, abi::subscription_entry_offset(abi::publisher_count_max, index));
  }

  Memory memory;
  Registry registry;
};

TEST_F(RegistryTest, GivesOutLowestIndexesAndFreshGenerations) {
  const ClientIndex a = client(), b = client();
  EXPECT_EQ(number(a), 0u);
  EXPECT_EQ(number(b), 1u);
  const TopicIndex t = topic();
  const auto p = publisher(a, t), q = publisher(b, t);
  EXPECT_EQ(p.index, 0u);
  EXPECT_EQ(q.index, 1u);
  EXPECT_GT(q.generation, p.generation);
  EXPECT_EQ(p.extent, abi::page_bytes);
  EXPECT_EQ(q.extent, abi::page_bytes) << "every process has a region of its own";
  EXPECT_EQ(abi::generation_of(publisher_word(t, 0)), p.generation);
  EXPECT_EQ(abi::state_of(publisher_word(t, 1)), abi::MemberState::active);
}

TEST_F(RegistryTest, UsesAnIndexAgainOnlyWhenNobodyKnowsTheOldOne) {
  const ClientIndex a = client(), b = client();
  const TopicIndex t = topic();
  const auto p = publisher(a, t);
  const EndpointRef ref{Kind::publisher, t, p.index};
  registry.tell(ref, b);
  EXPECT_TRUE(registry.client(a).told.contains(number(b))) << "its region is known with it";
  registry.orphan_publisher(t, p.index, abi::pack_entry(p.first_sequence, 0));
  EXPECT_EQ(publisher(a, t).index, 1u);
  registry.let_go(ref, b);
  registry.end_publisher(t, p.index, EndpointState::over);
  EXPECT_EQ(abi::state_of(publisher_word(t, 0)), abi::MemberState::free);
  EXPECT_EQ(publisher(a, t).index, 2u) << "its own process has not let go of the extent";
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
  EXPECT_EQ(q.extent, s.extent + abi::subscription_extent_bytes);
  registry.change_subscription(t, s.index, EndpointState::over);
  registry.free_subscription(t, s.index);
  EXPECT_EQ(publisher(a, t).extent, q.extent + abi::publisher_extent_bytes)
      << "a publisher does not fit where a subscription was";
  EXPECT_EQ(subscription(a, t).extent, s.extent);
}

TEST_F(RegistryTest, RaisesSlotsBeforeADeepSubscriptionIsAMember) {
  const ClientIndex a = client();
  const TopicIndex t = topic();
  const auto p = publisher(a, t, 1);
  EXPECT_EQ(p.slot_count, abi::near_slot_count);
  const abi::Qos qos{500, false, true, false, false};
  const auto plan = registry.plan_subscription(a, t, qos, {100, 1}).value();
  ASSERT_EQ(plan.raises.size(), 1u);
  EXPECT_EQ(plan.raises[0].slot_count, 640u);  // 500 + 100 + 34, whole words
  registry.raise_slots(t, plan.raises[0]);
  EXPECT_EQ(
      board_word(t, abi::publisher_entry_offset(0) + offsetof(abi::PublisherEntry, slot_count)),
      640u);
  EXPECT_TRUE(registry.uses_far_slots(t));
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
  registry.open_executor(b, 0);
  registry.open_executor(b, 5);
  const Usage usage = registry.usage_of(1);
  EXPECT_EQ(usage.clients, 2u);
  EXPECT_EQ(usage.publishers, 1u);
  EXPECT_EQ(usage.subscriptions, 1u);
  EXPECT_EQ(usage.executors, 2u);
  EXPECT_EQ(usage.windows, 1u);
  EXPECT_EQ(usage.heap_bytes, 4096u);
  EXPECT_EQ(usage.held_messages, 7u);
  EXPECT_EQ(usage.topics, 1u);
  EXPECT_EQ(registry.usage_of(3).clients, 0u);
}

TEST_F(RegistryTest, EndsAProcessOnlyWhenNothingOfItIsKnown) {
  const ClientIndex a = client(), b = client();
  const TopicIndex t = topic();
  const auto p = publisher(a, t);
  registry.tell({Kind::publisher, t, p.index}, b);
  EXPECT_FALSE(registry.can_free(a));
  registry.client_died(a, journal::DeathReason::died);
  registry.orphan_publisher(t, p.index, 0);
  EXPECT_FALSE(registry.can_free(a));
  registry.let_go({Kind::publisher, t, p.index}, b);
  registry.end_publisher(t, p.index, EndpointState::free);
  EXPECT_FALSE(registry.can_free(a)) << "b still maps its region";
  registry.let_go_of_region(a, b);
  EXPECT_FALSE(registry.can_free(a)) << "it counts as told of what others have";
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
  registry.tell({Kind::publisher, t, p.index}, b);
  registry.tell({Kind::subscription, u, s.index}, b);
  registry.client_died(b, journal::DeathReason::died);
  EXPECT_EQ(registry.known_topic_of(b), t);
  registry.acknowledge_topic(b, t);
  EXPECT_EQ(registry.known_topic_of(b), u);
  registry.acknowledge_topic(b, u);
  EXPECT_FALSE(registry.known_topic_of(b));
  EXPECT_TRUE(registry.client(a).told.contains(number(b))) << "its region is let go of last";
  registry.client_forgotten(b);
  EXPECT_TRUE(registry.told_of({Kind::publisher, t, p.index}).reusable());
  EXPECT_TRUE(registry.told_of({Kind::subscription, u, s.index}).reusable());
  EXPECT_TRUE(registry.client(a).told.reusable());
}

TEST_F(RegistryTest, FreesATopicWithItsLastEndpointAndFixesTheTypeAnew) {
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
  EXPECT_GE(board_word(t, offsetof(abi::TopicHeader, epoch)), epoch) << "an epoch never goes back";
}

TEST_F(RegistryTest, KeepsDomainsApart) {
  const TopicIndex t = topic();
  EXPECT_FALSE(registry.find_topic(1, "/topic"));
  const TopicIndex other = registry.add_topic({1, "/topic", "pkg/msg/Other", 6}).value();
  EXPECT_NE(t, other);
  EXPECT_EQ(registry.find_topic(1, "/topic"), other);
}

TEST_F(RegistryTest, SaysWhenATableIsFull) {
  const ClientIndex a = client();
  const TopicIndex t = topic();
  for (std::uint32_t i = 0; i < abi::publisher_count_max; ++i) publisher(a, t);
  const auto full = registry.plan_publisher(a, t, {1, false, true, false, false});
  ASSERT_FALSE(full);
  EXPECT_EQ(full.error().code, Errc::limit_reached);
  for (std::uint32_t i = 1; i < abi::client_count_max; ++i) client();
  const auto no_client = registry.add_client({0, 0, 0, 0, ""});
  ASSERT_FALSE(no_client);
  EXPECT_EQ(no_client.error().code, Errc::limit_reached);
}

TEST_F(RegistryTest, IsFoundAgainByALaterLife) {
  const ClientIndex a = client(), b = client();
  const TopicIndex t = topic();
  const auto p = publisher(a, t);
  registry.tell({Kind::publisher, t, p.index}, b);
  Registry later(memory.parts());
  ASSERT_TRUE(later.open());
  EXPECT_EQ(later.find_topic(0, "/topic"), t);
  EXPECT_EQ(later.endpoints_of(a).size(), 1u);
  EXPECT_TRUE(later.told_of({Kind::publisher, t, 0}).contains(number(b)));
  const auto q = later.plan_publisher(a, t, {1, false, true, false, false}).value();
  EXPECT_EQ(q.index, 1u);
  EXPECT_EQ(q.extent, p.extent + abi::publisher_extent_bytes);
  EXPECT_GT(q.generation, p.generation);
}

TEST_F(RegistryTest, RefusesMemoryOfAnotherLayoutAndSaysBoth) {
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
  // The tables may differ where the regions do not.
  fingerprint.store(abi::fingerprint());
  ASSERT_TRUE(Registry(memory.parts()).open());
  SharedMemory::word(memory.parts().tables, offsetof(TableHeader, layout)).store(7);
  const auto tables = Registry(memory.parts()).open();
  ASSERT_FALSE(tables);
  EXPECT_EQ(tables.error().code, Errc::layout_mismatch);
}

TEST_F(RegistryTest, RefusesDamageAndSaysWhich) {
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
  refused_with([&] { log_word(0).store(1); }, "does not begin like one");
  refused_with([&] { log_word(128).store(log_word(64).load() + 1); }, "has not committed");
  refused_with([&] { log_word(128).store(log_word(64).load() - 2); }, "has not committed");
  refused_with(
      [&] {
        const std::uint64_t committed = log_word(64).load();
        log_word(128).store(committed - 1);
        log_word(4096 + committed * sizeof(journal::Record) + 40).fetch_xor(1);
      },
      "last record of the journal is not whole");
  refused_with([&] { tables.header.magic = 0; }, "do not begin like tables");
  refused_with([&] { tables.header.client_high = abi::client_count_max + 1; }, "out of range");
  refused_with([&] { tables.client[0].window_count = 99; }, "windows of a process");
  refused_with([&] { tables.client[0].state = static_cast<ClientState>(9); }, "state of a process");
  refused_with([&] { tables.publisher[0][0].extent = Registry::client_region_bytes; },
               "a publisher");
  refused_with([&] { tables.publisher[0][0].client = ClientIndex{77}; }, "a publisher");
  refused_with([&] { tables.publisher[0][0].state = EndpointState::free; }, "a publisher");
  refused_with([&] { tables.topic[0].subscriptions[3] = 1; }, "places of a topic");
  refused_with([&] { log_word(16).store(2); }, "not of one incarnation");
}

TEST_F(RegistryTest, GivesOutNoFreePlaceThatSomebodyIsStillToldOf) {
  const ClientIndex a = client();
  const TopicIndex t = topic();
  const abi::Qos qos{1, false, true, false, false};
  publisher(a, t);
  subscription(a, t);
  Tables& tables = *reinterpret_cast<Tables*>(memory.parts().tables);
  tables.publisher[number(t)][1].told.tell(5);
  tables.subscription[number(t)][1].told.tell(5);
  const auto of_publisher = registry.plan_publisher(a, t, qos);
  ASSERT_FALSE(of_publisher);
  EXPECT_EQ(of_publisher.error().code, Errc::store_damaged);
  const auto of_subscription = registry.plan_subscription(a, t, qos, {1, 1});
  ASSERT_FALSE(of_subscription);
  EXPECT_EQ(of_subscription.error().code, Errc::store_damaged);
  // One that was used before is passed over.
  const EndpointRef ref{Kind::subscription, t, 0};
  registry.change_subscription(t, 0, EndpointState::over);
  registry.free_subscription(t, 0);
  tables.subscription[number(t)][1].told.let_go(5, 0);
  tables.subscription[number(t)][0].told.tell(5);
  EXPECT_FALSE(registry.is_used(ref));
  EXPECT_EQ(registry.plan_subscription(a, t, qos, {1, 1}).value().index, 1u);
}

/// Pages of the tables that have memory.
std::uint64_t pages_of(const Registry::Memory& memory) {
  const auto page = static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
  std::vector<unsigned char> there(tables_bytes / page);
  EXPECT_EQ(::mincore(memory.tables, there.size() * page, there.data()), 0);
  return static_cast<std::uint64_t>(
      std::count_if(there.begin(), there.end(), [](unsigned char one) { return (one & 1) != 0; }));
}

// Places that were used once cost nothing, whoever took them and however high they were.
TEST_F(RegistryTest, GivesTheMemoryOfFreePlacesBack) {
  const ClientIndex a = client();
  std::vector<TopicIndex> topics;
  for (int i = 0; i < 3; ++i) topics.push_back(topic("/topic" + std::to_string(i)));
  subscription(a, topics[0]);
  publisher(a, topics[0]);
  const std::uint64_t before = pages_of(memory.parts());
  for (const TopicIndex at : topics) {
    while (registry.topic(at).subscription_high < abi::subscription_count_max) subscription(a, at);
    while (registry.topic(at).publisher_high < abi::publisher_count_max) publisher(a, at);
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
  // The first topic keeps its first and its last places: what lies between them goes all the same.
  const auto is_kept = [&](const EndpointRef& ref) {
    const std::uint32_t last = ref.kind == Kind::publisher ? abi::publisher_count_max - 1
                                                           : abi::subscription_count_max - 1;
    return ref.topic == topics[0] && (ref.index == 0 || ref.index == last);
  };
  for (const EndpointRef& ref : std::vector(registry.endpoints_of(a))) {
    if (!is_kept(ref)) end(ref);
  }
  for (const std::size_t i : {1u, 2u}) registry.free_topic(topics[i]);
  // A page for each of two places, and two for one that lies in both.
  EXPECT_LE(pages_of(memory.parts()), before + 6);
  // Nobody looks at what is not there: not to walk, not to answer who names a place, not at a start.
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
  // And what is given out again is as if it were new.
  const auto again = later.plan_subscription(a, topics[0], {1, false, true, false, false}, {1, 1}).value();
  EXPECT_EQ(again.index, 1u);
}

TEST_F(RegistryTest, VisitsWhatIsThereThoughItEndsMeanwhile) {
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

TEST_F(RegistryTest, MakesTheBoardSayWhatTheTablesSay) {
  const ClientIndex a = client();
  const TopicIndex t = topic();
  const auto p = publisher(a, t);
  const region::TopicWords<SharedMemory> words{memory.board(), abi::topic_offset(number(t))};
  Registry later(memory.parts());
  ASSERT_TRUE(later.open());
  const std::uint64_t epoch = words.epoch().load(std::memory_order_relaxed);
  EXPECT_EQ(later.repair_board(), 0u);
  EXPECT_GT(words.epoch().load(std::memory_order_relaxed), epoch) << "everybody looks again";
  const std::size_t fields[] = {
      offsetof(abi::PublisherEntry, word),       offsetof(abi::PublisherEntry, qos),
      offsetof(abi::PublisherEntry, client),     offsetof(abi::PublisherEntry, extent),
      offsetof(abi::PublisherEntry, slot_count), offsetof(abi::PublisherEntry, first_sequence),
      offsetof(abi::PublisherEntry, final_head)};
  for (const std::size_t field : fields) {
    auto&& word = words.publisher(p.index, field);
    const std::uint64_t before = word.load(std::memory_order_relaxed);
    word.store(before ^ 0x100, std::memory_order_relaxed);
    EXPECT_EQ(later.repair_board(), 1u) << field;
    EXPECT_EQ(word.load(std::memory_order_relaxed), before) << field;
  }
}

/// As the tables say it, counted from the beginning.
Usage counted(const Registry& registry, std::uint32_t uid) {
  Usage usage;
  std::set<TopicIndex> topics;
  for (std::uint32_t i = 0; i < registry.client_high(); ++i) {
    const ClientRecord& record = registry.client(ClientIndex{i});
    if (record.state == ClientState::free || record.uid != uid) continue;
    ++usage.clients;
    for (const EndpointRef& ref : registry.endpoints_of(ClientIndex{i})) {
      topics.insert(ref.topic);
      ++(ref.kind == Kind::publisher ? usage.publishers : usage.subscriptions);
      if (ref.kind == Kind::subscription)
        usage.held_messages += registry.subscription(ref.topic, ref.index).quota;
    }
    usage.executors += static_cast<std::uint64_t>(std::popcount(record.executors));
    usage.windows += record.window_count;
    for (std::uint64_t w = 0; w < record.window_count; ++w)
      usage.heap_bytes += record.window[w].bytes;
  }
  usage.topics = topics.size();
  return usage;
}

// Places of processes are given to other users, and changes are completed by another life.
TEST_F(RegistryTest, KeepsTheUsageThatACountWouldFind) {
  std::mt19937 random(7);
  auto life = std::make_unique<Registry>(memory.parts());
  ASSERT_TRUE(life->open());
  const abi::Qos qos{1, false, true, false, false};
  std::vector<TopicIndex> topics;
  for (const char* const name : {"/a", "/b", "/c"})
    topics.push_back(life->add_topic({0, name, "T", 1}).value());
  std::vector<ClientIndex> clients;
  std::uint64_t ended = 0;
  for (int step = 0; step < 4000; ++step) {
    if (clients.size() < 6) {
      const std::uint32_t uid = 1 + static_cast<std::uint32_t>(random() % 3);
      clients.push_back(life->add_client({uid, uid, 1, 0, "process"}).value());
    }
    const ClientIndex one = clients[random() % clients.size()];
    const TopicIndex at = topics[random() % topics.size()];
    const auto& endpoints = life->endpoints_of(one);
    switch (random() % 6) {
      case 0:
        life->add_publisher(one, at, qos, life->plan_publisher(one, at, qos).value(), "node");
        break;
      case 1: {
        const HoldQuota quota{random() % 9, 1};
        const auto plan = life->plan_subscription(one, at, qos, quota).value();
        for (const SlotRaise& raise : plan.raises) life->raise_slots(at, raise);
        life->add_subscription(one, at, qos, quota, 0, plan, "node");
        break;
      }
      case 2:
        if (life->client(one).window_count < abi::window_count_max)
          life->open_window(one, {0x1000, 4096 * (1 + random() % 9), 0});
        break;
      case 3:
        life->open_executor(one, static_cast<std::uint32_t>(random() % 8));
        break;
      case 4:
        for (int i = 0; i < 3 && !endpoints.empty(); ++i) {
          const EndpointRef ref = endpoints[random() % endpoints.size()];
          if (ref.kind == Kind::publisher) {
            life->orphan_publisher(ref.topic, ref.index, 0);
            life->end_publisher(ref.topic, ref.index, EndpointState::over);
            life->end_publisher(ref.topic, ref.index, EndpointState::free);
          } else {
            life->change_subscription(ref.topic, ref.index, EndpointState::over);
            life->free_subscription(ref.topic, ref.index);
          }
        }
        break;
      default:
        if (!endpoints.empty()) break;
        life->client_died(one, journal::DeathReason::died);
        life->client_forgotten(one);
        life->free_client(one);
        std::erase(clients, one);
        ++ended;
    }
    if (random() % 10 == 0) {
      auto& applied = SharedMemory::word(memory.parts().log, 128);  // as below
      applied.store(applied.load() - 1);
      life = std::make_unique<Registry>(memory.parts());
      ASSERT_TRUE(life->open());
    }
    for (const std::uint32_t uid : {0U, 1U, 2U, 3U}) {
      ASSERT_TRUE(life->usage_of(uid) == counted(*life, uid)) << "step " << step << " user " << uid;
      for (const TopicIndex topic : topics) {
        bool takes_part = false;
        for (const ClientIndex c : clients) {
          for (const EndpointRef& ref : life->endpoints_of(c))
            takes_part = takes_part || (ref.topic == topic && life->client(c).uid == uid);
        }
        ASSERT_EQ(life->takes_part(uid, topic), takes_part) << "step " << step;
        std::uint64_t publishers = 0, subscriptions = 0;
        for (const ClientIndex c : clients) {
          if (life->client(c).uid != uid) continue;
          for (const EndpointRef& ref : life->endpoints_of(c)) {
            if (ref.topic == topic)
              ++(ref.kind == Kind::publisher ? publishers : subscriptions);
          }
        }
        ASSERT_EQ(life->user_places(uid, topic).publishers, publishers) << "step " << step;
        ASSERT_EQ(life->user_places(uid, topic).subscriptions, subscriptions) << "step " << step;
      }
    }
  }
  EXPECT_GT(ended, 20u);
}

// A trivial model of what the tables must say, kept by hand beside random operations. Every now and
// then the last record is made pending again, as a death between commit and applied would leave it,
// and a new registry takes over: redoing it must change nothing but the epoch.
TEST_F(RegistryTest, AgreesWithAModelOverManyLives) {
  struct Member {
    std::uint32_t owner, index;
    std::uint64_t generation, extent;
    std::set<std::uint32_t> told;
    EndpointState state;
  };
  std::mt19937 random(99);
  auto life = std::make_unique<Registry>(memory.parts());
  ASSERT_TRUE(life->open());
  std::vector<ClientIndex> clients;
  for (int i = 0; i < 6; ++i) clients.push_back(life->add_client({1, 1, 1, 0, "process"}).value());
  const TopicIndex t = life->add_topic({0, "/topic", "T", 1}).value();
  std::vector<Member> members;  // publishers
  std::set<std::uint64_t> generations;
  for (int step = 0; step < 5000; ++step) {
    const auto what = random() % 6;
    if (what == 0 && members.size() < 40) {
      const ClientIndex owner = clients[random() % clients.size()];
      const abi::Qos qos{1, false, true, false, false};
      const auto plan = life->plan_publisher(owner, t, qos).value();
      std::uint32_t lowest = 0;
      while (std::any_of(members.begin(), members.end(),
                         [&](const Member& m) { return m.index == lowest; }))
        ++lowest;
      ASSERT_EQ(plan.index, lowest);
      ASSERT_TRUE(generations.insert(plan.generation).second) << "a generation came twice";
      for (const Member& m : members) {
        if (m.owner != number(owner)) continue;
        ASSERT_TRUE(plan.extent + abi::publisher_extent_bytes <= m.extent ||
                    m.extent + abi::publisher_extent_bytes <= plan.extent)
            << "two endpoints share an extent";
      }
      life->add_publisher(owner, t, qos, plan, "node");
      members.push_back(
          {number(owner), plan.index, plan.generation, plan.extent, {}, EndpointState::active});
    } else if (!members.empty()) {
      const std::size_t at = random() % members.size();
      Member& m = members[at];
      const EndpointRef ref{Kind::publisher, t, m.index};
      const ClientIndex other = clients[random() % clients.size()];
      if (what == 1 && m.state == EndpointState::active) {
        life->tell(ref, other);
        m.told.insert(number(other));
      } else if (what == 2) {
        life->let_go(ref, other);
        m.told.erase(number(other));
      } else if (what == 3 && m.state == EndpointState::active) {
        life->orphan_publisher(t, m.index, 12);
        m.state = EndpointState::orphan;
      } else if (what == 4 && m.told.empty() && m.state == EndpointState::orphan) {
        life->end_publisher(t, m.index, EndpointState::over);
        m.state = EndpointState::over;
      } else if (what == 5 && m.told.empty() && m.state == EndpointState::over) {
        life->end_publisher(t, m.index, EndpointState::free);
        members.erase(members.begin() + static_cast<std::ptrdiff_t>(at));
      }
    }
    if (random() % 20 == 0) {
      // applied is the word at 128 of the log (journal/redo_log.hpp).
      auto& applied = SharedMemory::word(memory.parts().log, 128);
      applied.store(applied.load() - 1);
      life = std::make_unique<Registry>(memory.parts());
      ASSERT_TRUE(life->open());
    }
    for (const Member& m : members) {
      const PublisherRecord& record = life->publisher(t, m.index);
      ASSERT_EQ(record.state, m.state);
      ASSERT_EQ(record.generation, m.generation);
      ASSERT_EQ(record.extent, m.extent);
      ASSERT_EQ(abi::generation_of(publisher_word(t, m.index)), m.generation);
      for (const ClientIndex c : clients)
        ASSERT_EQ(record.told.contains(number(c)), m.told.count(number(c)) != 0);
    }
    std::size_t known = 0;
    for (const ClientIndex c : clients) known += life->endpoints_of(c).size();
    ASSERT_EQ(known, members.size());
  }
  EXPECT_GT(generations.size(), 200u);
}

}  // namespace
}  // namespace agnocast::daemon
