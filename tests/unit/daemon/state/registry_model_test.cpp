// SPDX-License-Identifier: Apache-2.0
//
// Goal: the registry's tables, boards and counts agree with a trivial model over many
// incarnations. Method: seeded random operations; the boards are read as clients read them.

#include <tests/unit/daemon/state/registry_fixture.hpp>

namespace agnocast::daemon {
namespace {

TEST_F(RegistryTest, MakesTheBoardAgreeWithTheTables) {
  const ClientIndex a = client();
  const TopicIndex t = topic();
  const auto p = publisher(a, t);
  const region::TopicWords<SharedMemory> words{memory.board(), abi::topic_offset(number(t))};
  Registry later(memory.parts());
  ASSERT_TRUE(later.open());
  const std::uint64_t epoch = words.epoch().load(std::memory_order_relaxed);
  EXPECT_EQ(later.repair_board(), 0u);
  EXPECT_GT(words.epoch().load(std::memory_order_relaxed), epoch) << "every client must look again";
  const std::size_t fields[] = {
      offsetof(abi::PublisherEntry, word),        offsetof(abi::PublisherEntry, policies),
      offsetof(abi::PublisherEntry, client),      offsetof(abi::PublisherEntry, extent),
      offsetof(abi::PublisherEntry, slot_count),  offsetof(abi::PublisherEntry, final_head),
      offsetof(abi::PublisherEntry, deadline_ns), offsetof(abi::PublisherEntry, lease_ns)};
  for (const std::size_t field : fields) {
    auto&& word = words.publisher(p.index, field);
    const std::uint64_t before = word.load(std::memory_order_relaxed);
    word.store(before ^ 0x100, std::memory_order_relaxed);
    EXPECT_EQ(later.repair_board(), 1u) << field;
    EXPECT_EQ(word.load(std::memory_order_relaxed), before) << field;
  }
}

/// Returns the usage counted anew from the tables.
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
    usage.wait_sets += static_cast<std::uint64_t>(std::popcount(record.wait_sets));
    usage.windows += record.window_count;
    for (std::uint64_t w = 0; w < record.window_count; ++w)
      usage.heap_bytes += record.window[w].bytes;
  }
  usage.topics = topics.size();
  return usage;
}

// Places of processes are reused by other users, and a later daemon completes changes.
// Long because each random operation has its branch.
TEST_F(RegistryTest, KeepsTheUsageEqualToACount) {
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
        life->open_wait_set(one, static_cast<std::uint32_t>(random() % 8));
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
      ASSERT_TRUE(life->accounts().usage_of(uid) == counted(*life, uid))
          << "step " << step << " user " << uid;
      for (const TopicIndex topic : topics) {
        bool takes_part = false;
        for (const ClientIndex c : clients) {
          for (const EndpointRef& ref : life->endpoints_of(c))
            takes_part = takes_part || (ref.topic == topic && life->client(c).uid == uid);
        }
        ASSERT_EQ(life->accounts().takes_part(uid, topic), takes_part) << "step " << step;
        std::uint64_t publishers = 0, subscriptions = 0;
        for (const ClientIndex c : clients) {
          if (life->client(c).uid != uid) continue;
          for (const EndpointRef& ref : life->endpoints_of(c)) {
            if (ref.topic == topic) ++(ref.kind == Kind::publisher ? publishers : subscriptions);
          }
        }
        ASSERT_EQ(life->accounts().user_places(uid, topic).publishers, publishers)
            << "step " << step;
        ASSERT_EQ(life->accounts().user_places(uid, topic).subscriptions, subscriptions)
            << "step " << step;
      }
    }
  }
  EXPECT_GT(ended, 20u);
}

// A trivial model of the tables, maintained beside random operations. Now and then the last record
// is made pending again, as a death between commit and applied would leave it, and a new registry
// takes over: redoing the record must change nothing but the epoch.
// Long because each random operation has its branch, in the registry and in the model.
TEST_F(RegistryTest, AgreesWithAModelOverManyRestarts) {
  struct KnownPublisher {
    std::uint32_t owner, index;
    std::uint64_t generation, extent;
    std::set<std::uint32_t> notified;
    EndpointState state;
  };
  std::mt19937 random(99);
  auto life = std::make_unique<Registry>(memory.parts());
  ASSERT_TRUE(life->open());
  std::vector<ClientIndex> clients;
  for (int i = 0; i < 6; ++i) clients.push_back(life->add_client({1, 1, 1, 0, "process"}).value());
  const TopicIndex t = life->add_topic({0, "/topic", "T", 1}).value();
  std::vector<KnownPublisher> publishers;
  std::set<std::uint64_t> generations;
  for (int step = 0; step < 5000; ++step) {
    const auto what = random() % 6;
    if (what == 0 && publishers.size() < 40) {
      const ClientIndex owner = clients[random() % clients.size()];
      const abi::Qos qos{1, false, true, false, false};
      const auto plan = life->plan_publisher(owner, t, qos).value();
      std::uint32_t lowest = 0;
      while (std::any_of(publishers.begin(), publishers.end(),
                         [&](const KnownPublisher& m) { return m.index == lowest; }))
        ++lowest;
      ASSERT_EQ(plan.index, lowest);
      ASSERT_TRUE(generations.insert(plan.generation).second) << "a generation was used twice";
      for (const KnownPublisher& m : publishers) {
        if (m.owner != number(owner)) continue;
        ASSERT_TRUE(plan.extent + abi::publisher_extent_bytes <= m.extent ||
                    m.extent + abi::publisher_extent_bytes <= plan.extent)
            << "two endpoints share an extent";
      }
      life->add_publisher(owner, t, qos, plan, "node");
      publishers.push_back(
          {number(owner), plan.index, plan.generation, plan.extent, {}, EndpointState::active});
    } else if (!publishers.empty()) {
      const std::size_t at = random() % publishers.size();
      KnownPublisher& m = publishers[at];
      const EndpointRef ref{Kind::publisher, t, m.index};
      const ClientIndex other = clients[random() % clients.size()];
      if (what == 1 && m.state == EndpointState::active) {
        life->notify(ref, other);
        m.notified.insert(number(other));
      } else if (what == 2) {
        life->acknowledge_unmap(ref, other);
        m.notified.erase(number(other));
      } else if (what == 3 && m.state == EndpointState::active) {
        life->orphan_publisher(t, m.index, 12);
        m.state = EndpointState::orphan;
      } else if (what == 4 && m.notified.empty() && m.state == EndpointState::orphan) {
        life->end_publisher(t, m.index, EndpointState::over);
        m.state = EndpointState::over;
      } else if (what == 5 && m.notified.empty() && m.state == EndpointState::over) {
        life->end_publisher(t, m.index, EndpointState::free);
        publishers.erase(publishers.begin() + static_cast<std::ptrdiff_t>(at));
      }
    }
    if (random() % 20 == 0) {
      // The word at 128 of the log is `applied` (journal/redo_log.hpp).
      auto& applied = SharedMemory::word(memory.parts().log, 128);
      applied.store(applied.load() - 1);
      life = std::make_unique<Registry>(memory.parts());
      ASSERT_TRUE(life->open());
    }
    for (const KnownPublisher& m : publishers) {
      const PublisherRecord& record = life->publisher(t, m.index);
      ASSERT_EQ(record.state, m.state);
      ASSERT_EQ(record.generation, m.generation);
      ASSERT_EQ(record.extent, m.extent);
      ASSERT_EQ(abi::generation_of(publisher_word(t, m.index)), m.generation);
      for (const ClientIndex c : clients)
        ASSERT_EQ(record.notified.contains(number(c)), m.notified.count(number(c)) != 0);
    }
    std::size_t known = 0;
    for (const ClientIndex c : clients) known += life->endpoints_of(c).size();
    ASSERT_EQ(known, publishers.size());
  }
  EXPECT_GT(generations.size(), 200u);
}

}  // namespace
}  // namespace agnocast::daemon
