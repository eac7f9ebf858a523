// SPDX-License-Identifier: Apache-2.0
//
// Goal: audit() finds what a daemon could hand out wrongly, which no client can cause, and reads
// nothing that does not exist. Method: hand-made systems in plain memory: a sound one, then one
// mistake at a time.

#include <ctl/snapshot/audit.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/memory/memfd.hpp>

#include <gtest/gtest.h>

#include <functional>
#include <string>
#include <vector>

namespace agnocast::ctl {
namespace {

using journal::Invariant;
using M = SharedMemory;

constexpr std::uint64_t arena = 0x200000000000;
constexpr std::uint64_t granule = abi::window_granule_bytes;
constexpr std::uint64_t region_bytes = std::uint64_t{1} << 20;

wire::Name name(const char* text) {
  wire::Name result{};
  std::snprintf(result.text, sizeof result.text, "%s", text);
  return result;
}

/// Two processes with a heap window each: a publisher of the first, and a subscription of the
/// second that is linked to it.
struct Made {
  Made() : board(abi::topic_offset(2) / 8) {
    system.board = reinterpret_cast<std::byte*>(board.data());
    system.daemon.arena_base = arena;
    system.daemon.arena_bytes = 16 * granule;
    for (std::uint64_t i = 0; i < 2; ++i) add_process(i);
    Topic topic;
    topic.facts.topic = 1;
    topic.facts.link_blocks = 1;
    topic.name = "/topic";
    system.topics.emplace(1, std::move(topic));
    add_endpoint(wire::Kind::publisher, 0, 0, 11, abi::page_bytes);
    add_endpoint(wire::Kind::subscription, 0, 1, 12, abi::page_bytes);
    const std::uint64_t first = publisher().facts.first_sequence;
    const region::PublisherWords<M> queue{system.processes.at(0).region.base(), abi::page_bytes};
    queue_words = queue;
    SharedMemory::word(queue.region, queue.extent).store(abi::pack_entry(first, 0));
  }
  Endpoint& publisher() { return system.topics.at(1).publishers.at(0); }
  Endpoint& subscription() { return system.topics.at(1).subscriptions.at(0); }
  region::TopicWords<M> words() { return system.words_of(system.topics.at(1)); }

  void add_process(std::uint64_t index) {
    Process process;
    process.facts.client = index;
    process.facts.generation = 100 + index;
    process.facts.window_count = 1;
    process.facts.window[0] = {arena + index * granule, granule, 0};
    process.name = "made";
    const UniqueFd fd = std::move(make_memfd("test", region_bytes).value());
    process.region =
        std::move(Mapping::map(fd.get(), region_bytes, Mapping::Access::read_write).value());
    auto& header = *reinterpret_cast<abi::ClientRegionHeader*>(process.region.base());
    header.magic.store(abi::client_region_magic);
    header.fingerprint.store(abi::fingerprint());
    header.generation.store(process.facts.generation);
    system.processes.emplace(index, std::move(process));
  }

  void add_endpoint(wire::Kind kind, std::uint64_t index, std::uint64_t client,
                    std::uint64_t generation, std::uint64_t extent) {
    Endpoint endpoint;
    wire::DumpEndpoint& facts = endpoint.facts;
    facts.kind = kind;
    facts.topic = 1;
    facts.index = index;
    facts.generation = generation;
    facts.board_word = abi::pack_board_word(generation, abi::BoardState::active);
    facts.client = client;
    facts.client_generation = 100 + client;
    facts.qos = abi::pack_qos({5});
    facts.extent = extent;
    facts.node = name("/node");
    if (kind == wire::Kind::publisher) {
      using Entry = abi::PublisherEntry;
      facts.slot_count = 64;
      facts.first_sequence = abi::first_sequence_of(generation);
      words().publisher_high().store(index + 1);
      words().publisher(index, offsetof(Entry, word)).store(facts.board_word);
      words().publisher(index, offsetof(Entry, policies)).store(facts.qos.policies);
      words().publisher(index, offsetof(Entry, client)).store(client);
      words().publisher(index, offsetof(Entry, extent)).store(extent);
      words().publisher(index, offsetof(Entry, slot_count)).store(facts.slot_count);
      system.topics.at(1).publishers.push_back(endpoint);
    } else {
      using Entry = abi::SubscriptionEntry;
      facts.quota = 3;
      words().subscription_high().store(index + 1);
      words().subscription(index, offsetof(Entry, word)).store(facts.board_word);
      words().subscription(index, offsetof(Entry, policies)).store(facts.qos.policies);
      words().subscription(index, offsetof(Entry, client)).store(client);
      words().subscription(index, offsetof(Entry, extent)).store(extent);
      words().subscription(index, offsetof(Entry, quota)).store(facts.quota);
      system.topics.at(1).subscriptions.push_back(endpoint);
    }
  }

  System system;
  std::vector<std::uint64_t> board;
  region::PublisherWords<M> queue_words{};
};

TEST(Audit, FindsNothingInASoundSystem) {
  Made made;
  const Audit seen = audit(made.system, region_bytes);
  for (const Finding& finding : seen.findings)
    ADD_FAILURE() << finding.where << ": " << sentence_of(finding.invariant);
  EXPECT_EQ(seen.queues, 1u);
}

TEST(Audit, FindsEachMistakeOfTheDaemon) {
  struct Case {
    Invariant invariant;
    std::function<void(Made&)> destroy;
  };
  const Case cases[] = {
      {Invariant::window_inside,
       [](Made& m) { m.system.processes.at(1).facts.window[0].base = arena - granule; }},
      {Invariant::window_inside,
       [](Made& m) { m.system.processes.at(1).facts.window[0].bytes = 17 * granule; }},
      {Invariant::window_overlap,
       [](Made& m) { m.system.processes.at(1).facts.window[0].base = arena; }},
      {Invariant::window_overlap,
       [](Made& m) { m.system.processes.at(0).facts.window[0].bytes = 2 * granule; }},
      {Invariant::extent_inside, [](Made& m) { m.publisher().facts.extent = region_bytes; }},
      {Invariant::extent_inside, [](Made& m) { m.publisher().facts.extent = 0; }},
      {Invariant::extent_inside, [](Made& m) { m.publisher().facts.extent = ~std::uint64_t{0}; }},
      {Invariant::extent_inside, [](Made& m) { m.publisher().facts.extent += 8; }},
      {Invariant::extent_overlap,
       [](Made& m) { m.add_endpoint(wire::Kind::publisher, 1, 0, 13, 2 * abi::page_bytes); }},
      {Invariant::endpoint_process, [](Made& m) { m.publisher().facts.client_generation = 99; }},
      {Invariant::endpoint_process, [](Made& m) { m.publisher().facts.client = 7; }},
      {Invariant::board_endpoint,
       [](Made& m) { m.words().publisher(0, offsetof(abi::PublisherEntry, word)).store(5); }},
      {Invariant::board_endpoint,
       [](Made& m) { m.words().publisher(0, offsetof(abi::PublisherEntry, extent)).store(8); }},
      {Invariant::board_endpoint,
       [](Made& m) {
         m.words().subscription(0, offsetof(abi::SubscriptionEntry, quota)).store(8);
       }},
      {Invariant::board_endpoint,
       [](Made& m) {
         m.words().subscription(0, offsetof(abi::SubscriptionEntry, policies)).store(8);
       }},
      {Invariant::board_endpoint,
       [](Made& m) {
         m.words().subscription(0, offsetof(abi::SubscriptionEntry, deadline_ns)).store(8);
       }},
      {Invariant::board_endpoint,
       [](Made& m) {
         m.words().subscription(0, offsetof(abi::SubscriptionEntry, lease_ns)).store(8);
       }},
      {Invariant::board_free,
       [](Made& m) {
         m.words().publisher_high().store(3);
         m.words()
             .publisher(2, offsetof(abi::PublisherEntry, word))
             .store(abi::pack_board_word(9, abi::BoardState::orphan));
       }},
      {Invariant::region_readable,
       [](Made& m) { m.system.processes.at(0).region_fault = "too short"; }},
  };
  for (const Case& c : cases) {
    Made made;
    c.destroy(made);
    const Audit seen = audit(made.system, region_bytes);
    bool found = false;
    for (const Finding& finding : seen.findings) found = found || finding.invariant == c.invariant;
    EXPECT_TRUE(found) << sentence_of(c.invariant);
  }
}

TEST(Audit, FollowsNoImpossibleNumbers) {
  // The largest possible numbers, on a board that was never written: none is followed.
  Made made;
  made.words().publisher_high().store(~std::uint64_t{0});
  made.words().subscription_high().store(~std::uint64_t{0});
  made.system.processes.at(0).region.reset();
  region::LinkWords<M> line{made.system.processes.at(1).region.base(), abi::page_bytes, 253};
  line.publisher_generation().store(~std::uint64_t{0});
  line.cursor().store(~std::uint64_t{0});
  const Audit seen = audit(made.system, region_bytes);
  ASSERT_EQ(seen.findings.size(), 1u);
  EXPECT_EQ(seen.findings.begin()->invariant, Invariant::link_generation);
  EXPECT_EQ(seen.queues, 0u);
}

TEST(Audit, ChecksABusyQueueOnlyInPart) {
  Made made;
  made.queue_words.intent_op().store(abi::intent_publish);
  made.queue_words.order(7).store(~std::uint64_t{0});  // wrong only at rest
  const Audit seen = audit(made.system, region_bytes);
  EXPECT_TRUE(seen.findings.empty());
  EXPECT_EQ(seen.in_motion.size(), 1u);
  made.queue_words.intent_op().store(abi::intent_idle);
  EXPECT_EQ(audit(made.system, region_bytes).findings.size(), 1u);
}

TEST(Audit, ABusyQueueKeepsOnlyFindingsMadeAtRest) {
  // Two faults of one publisher. The board's fault is gone at the second look, which cannot see
  // the other fault.
  Made made;
  const std::uint64_t entry = made.queue_words.order(7).load();
  made.queue_words.order(7).store(~std::uint64_t{0});
  made.publisher().facts.slot_count = 32;
  std::set<Finding> findings = audit(made.system, region_bytes).findings;
  EXPECT_EQ(findings.size(), 2u);
  made.queue_words.intent_op().store(abi::intent_publish);
  made.publisher().facts.slot_count = 64;
  keep_what_lasts(findings, audit(made.system, region_bytes));
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_EQ(findings.begin()->invariant, Invariant::queue_order);
  made.queue_words.intent_op().store(abi::intent_idle);
  keep_what_lasts(findings, audit(made.system, region_bytes));
  EXPECT_EQ(findings.size(), 1u);
  made.queue_words.order(7).store(entry);
  keep_what_lasts(findings, audit(made.system, region_bytes));
  EXPECT_TRUE(findings.empty());
}

}  // namespace
}  // namespace agnocast::ctl
