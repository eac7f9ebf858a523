// SPDX-License-Identifier: Apache-2.0
//
// Goal: the graph table has exactly the endpoints that take part, also when they come and go many
// times, when processes die, and when there are more than it has room for; a reader never sees a
// mixture of two endpoints. Method: a registry over anonymous memory, the table read through a
// mapping of the readers' descriptor; a writer and a reader of one entry in two threads.

#include <daemon/observers/graph_table.hpp>

#include <region/graph_entry.hpp>
#include <tests/unit/daemon/state/registry_fixture.hpp>

#include <atomic>
#include <cstdio>
#include <random>
#include <set>
#include <string>
#include <thread>

namespace agnocast::daemon {
namespace {

class GraphTableTest : public RegistryTest {
 protected:
  /// Makes the table, as the first process that asks does.
  void open(GraphTable& table) {
    ASSERT_TRUE(table.open());
    mapping = std::move(
        Mapping::map(table.reader()->get(), abi::graph_bytes_max, Mapping::Access::read).value());
  }
  const abi::GraphHeader& header() const {
    return *reinterpret_cast<const abi::GraphHeader*>(mapping.base());
  }
  std::vector<region::GraphFacts> facts() const {
    std::vector<region::GraphFacts> all;
    for (std::uint64_t i = 0; i < header().entry_high.load(); ++i) {
      const auto& entry =
          *reinterpret_cast<const abi::GraphEntry*>(mapping.base() + abi::graph_entry_offset(i));
      if (const auto one = region::load_entry(entry)) all.push_back(*one);
    }
    return all;
  }
  std::set<std::uint64_t> generations() const {
    std::set<std::uint64_t> all;
    for (const auto& one : facts()) EXPECT_TRUE(all.insert(one.generation).second) << "twice";
    return all;
  }
  std::uint64_t changes() const { return header().changes.load(); }

  Mapping mapping;
};

TEST_F(GraphTableTest, TellsHowAnEndpointWasCreated) {
  const ClientIndex owner = client(77);
  const TopicIndex at = topic("/points");
  const auto before = publisher(owner, at, 9);
  GraphTable table(registry);
  open(table);
  ASSERT_EQ(facts().size(), 1u) << "it was there before the table";
  const region::GraphFacts first = facts()[0];
  EXPECT_EQ(header().magic.load(), abi::graph_magic);
  EXPECT_EQ(header().incarnation.load(), registry.incarnation());
  EXPECT_EQ(first.generation, before.generation);
  EXPECT_EQ(first.kind, Kind::publisher);
  EXPECT_EQ(first.layout_hash, 5u);
  EXPECT_EQ(abi::unpack_qos(first.qos).depth, 9u);
  EXPECT_EQ(first.client, registry.client(owner).generation);
  EXPECT_EQ(first.uid, 77u);
  EXPECT_EQ(first.pid, 1u);
  EXPECT_STREQ(first.topic.text, "/points");
  EXPECT_STREQ(first.type.text, "pkg/msg/Type");
  EXPECT_STREQ(first.node.text, "node");
  EXPECT_STREQ(first.process.text, "a process");
  EXPECT_FALSE(table.update(0)) << "nothing has changed";
}

TEST_F(GraphTableTest, FollowsWhatComesLeavesAndDies) {
  GraphTable table(registry);
  EXPECT_FALSE(table.update(0)) << "nobody watches";
  open(table);
  const ClientIndex a = client(), b = client();
  const TopicIndex at = topic();
  const auto p = publisher(a, at);
  const auto q = publisher(b, at);
  const auto s = subscription(b, at);
  EXPECT_TRUE(facts().empty()) << "it is written at the update";
  const std::uint64_t before = changes();
  EXPECT_TRUE(table.update(0));
  EXPECT_EQ(changes(), before + 1);
  EXPECT_EQ(generations(), (std::set{p.generation, q.generation, s.generation}));

  registry.orphan_publisher(at, p.index, 0);
  EXPECT_TRUE(table.update(0));
  EXPECT_EQ(generations(), (std::set{q.generation, s.generation}));
  registry.end_publisher(at, p.index, EndpointState::over);
  EXPECT_FALSE(table.update(0)) << "it was gone already";
  registry.end_publisher(at, p.index, EndpointState::free);
  const auto again = publisher(a, at);
  ASSERT_EQ(again.index, p.index);
  EXPECT_TRUE(table.update(0));
  EXPECT_EQ(generations(), (std::set{again.generation, q.generation, s.generation}));

  registry.client_died(b, journal::DeathReason::died);
  EXPECT_TRUE(table.update(0)) << "all at once, whatever is still to be undone";
  EXPECT_EQ(generations(), std::set{again.generation});
  const auto passing = publisher(a, at);
  registry.orphan_publisher(at, passing.index, 0);
  EXPECT_FALSE(table.update(0)) << "it came and went between two updates";
}

TEST_F(GraphTableTest, CountsWhatHasNoRoomAndFillsIn) {
  constexpr std::uint32_t room = abi::graph_block_entries;
  GraphTable table(registry, room);
  open(table);
  const ClientIndex owner = client();
  const TopicIndex at = topic();
  std::set<std::uint64_t> all;
  std::vector<PublisherPlan> plans;
  for (std::uint32_t i = 0; i < room + 2; ++i) plans.push_back(publisher(owner, at));
  for (const PublisherPlan& plan : plans) all.insert(plan.generation);
  EXPECT_TRUE(table.update(10'000));
  EXPECT_EQ(generations().size(), room);
  EXPECT_EQ(table.missing(), 2u);
  EXPECT_EQ(header().missing.load(), 2u);
  EXPECT_FALSE(table.update(20'000)) << "they still have no room";

  registry.orphan_publisher(at, plans[3].index, 0);
  EXPECT_TRUE(table.update(20'001));
  EXPECT_EQ(generations().size(), room - 1);
  EXPECT_TRUE(table.update(30'000));
  EXPECT_EQ(generations().size(), room);
  EXPECT_EQ(header().missing.load(), 1u);
  for (const std::uint64_t generation : generations()) EXPECT_TRUE(all.count(generation));
}

TEST_F(GraphTableTest, AgreesWithTheRegistryAfterRandomChanges) {
  GraphTable table(registry);
  std::mt19937 random(42);
  std::vector<ClientIndex> owners;
  for (int i = 0; i < 4; ++i) owners.push_back(client());
  std::vector<TopicIndex> topics;
  for (int i = 0; i < 3; ++i) topics.push_back(topic("/topic" + std::to_string(i)));
  std::set<std::uint64_t> there;
  std::vector<std::pair<EndpointRef, std::uint64_t>> live;
  for (int step = 0; step < 2'000; ++step) {
    if (step == 100) open(table);
    const TopicIndex at = topics[random() % topics.size()];
    const ClientIndex owner = owners[random() % owners.size()];
    if (live.size() < 200 && random() % 2 == 0) {
      const bool publishes = random() % 2 == 0;
      const std::uint64_t generation =
          publishes ? publisher(owner, at).generation : subscription(owner, at).generation;
      const EndpointRef last = registry.endpoints_of(owner).back();
      ASSERT_EQ(registry.generation_of(last), generation);
      live.emplace_back(last, generation);
      there.insert(generation);
    } else if (!live.empty()) {
      const std::size_t which = random() % live.size();
      const auto [ref, generation] = live[which];
      live.erase(live.begin() + static_cast<std::ptrdiff_t>(which));
      there.erase(generation);
      if (ref.kind == Kind::publisher) {
        registry.orphan_publisher(ref.topic, ref.index, 0);
        registry.end_publisher(ref.topic, ref.index, EndpointState::over);
        registry.end_publisher(ref.topic, ref.index, EndpointState::free);
      } else {
        registry.change_subscription(ref.topic, ref.index, EndpointState::over);
        registry.free_subscription(ref.topic, ref.index);
      }
    }
    if (step >= 100 && random() % 3 == 0) {
      table.update(0);
      ASSERT_EQ(generations(), there) << "step " << step;
    }
  }
}

TEST_F(GraphTableTest, ItsReadersCannotWrite) {
  GraphTable table(registry);
  open(table);
  EXPECT_FALSE(Mapping::map(table.reader()->get(), abi::page_bytes, Mapping::Access::read_write));
}

TEST(GraphEntry, IsNeverReadAsAMixture) {
  abi::GraphEntry entry{};
  std::atomic<bool> ends{false};
  std::thread writer([&] {
    for (std::uint64_t generation = 1; !ends; ++generation) {
      region::GraphFacts facts;
      facts.generation = facts.domain = facts.uid = facts.qos.lease_ns = generation;
      std::snprintf(facts.topic.text, sizeof facts.topic.text, "%llu",
                    static_cast<unsigned long long>(generation));
      facts.process = facts.node = facts.topic;
      if (generation % 5 == 0) region::clear_entry(entry);
      region::store_entry(entry, facts);
    }
  });
  std::uint64_t read = 0, last = 0;
  while (read < 2'000) {
    const auto facts = region::load_entry(entry);
    if (!facts) continue;
    ++read;
    const std::string text = std::to_string(facts->generation);
    ASSERT_EQ(facts->domain, facts->generation);
    ASSERT_EQ(facts->uid, facts->generation);
    ASSERT_EQ(facts->qos.lease_ns, facts->generation);
    ASSERT_EQ(facts->topic.text, text);
    ASSERT_EQ(facts->process.text, text);
    ASSERT_GE(facts->generation, last);
    last = facts->generation;
  }
  ends = true;
  writer.join();
}

}  // namespace
}  // namespace agnocast::daemon
