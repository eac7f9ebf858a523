// SPDX-License-Identifier: Apache-2.0
//
// Entries of the graph table: one writer, any number of readers, no locks.
//
//   writer   word = 0 ─▶ the other words ─▶ word = generation ─▶ … ─▶ GraphHeader::changes + 1
//   reader   word, not 0 ─▶ the other words ─▶ the same word? else the entry has changed meanwhile
//
// A generation is never used twice, so the same word means the same endpoint. A reader that skips
// an entry in the middle of a change reads it when it sees the next `changes`.
#pragma once

#include <agnocast/abi/graph_table.hpp>
#include <agnocast/abi/words.hpp>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <optional>

namespace agnocast::region {

/// One endpoint of the graph, as values.
struct GraphFacts {
  std::uint64_t generation = 0;
  abi::wire::Kind kind = abi::wire::Kind::publisher;
  std::uint64_t domain = 0;
  std::uint64_t layout_hash = 0;
  abi::QosWords qos{};
  std::uint64_t client = 0;  // generation of its process
  std::uint64_t pid = 0;
  std::uint64_t uid = 0;
  abi::wire::Name topic{}, type{}, node{}, process{};
};

namespace detail {

inline void store_name(abi::SharedWord (&words)[abi::graph_name_words],
                       const abi::wire::Name& name) noexcept {
  std::uint64_t numbers[abi::graph_name_words];
  std::memcpy(numbers, name.text, sizeof numbers);
  for (std::size_t i = 0; i < abi::graph_name_words; ++i)
    words[i].store(numbers[i], std::memory_order_relaxed);
}
inline void load_name(const abi::SharedWord (&words)[abi::graph_name_words],
                      abi::wire::Name& name) noexcept {
  std::uint64_t numbers[abi::graph_name_words];
  for (std::size_t i = 0; i < abi::graph_name_words; ++i)
    numbers[i] = words[i].load(std::memory_order_relaxed);
  std::memcpy(name.text, numbers, sizeof numbers);
}

}  // namespace detail

/// Writer. Removes the endpoint of this entry.
inline void clear_entry(abi::GraphEntry& entry) noexcept {
  entry.word.store(0, std::memory_order_release);
}

/// Writer. Replaces the endpoint of this entry; `facts` has a generation.
inline void store_entry(abi::GraphEntry& entry, const GraphFacts& facts) noexcept {
  entry.word.store(0, std::memory_order_relaxed);
  // [sync:graph] ahead of the other words; pairs with the reader's fence behind them.
  std::atomic_thread_fence(std::memory_order_release);
  entry.kind.store(static_cast<std::uint64_t>(facts.kind), std::memory_order_relaxed);
  entry.domain.store(facts.domain, std::memory_order_relaxed);
  entry.layout_hash.store(facts.layout_hash, std::memory_order_relaxed);
  entry.policies.store(facts.qos.policies, std::memory_order_relaxed);
  entry.deadline_ns.store(facts.qos.deadline_ns, std::memory_order_relaxed);
  entry.lifespan_ns.store(facts.qos.lifespan_ns, std::memory_order_relaxed);
  entry.lease_ns.store(facts.qos.lease_ns, std::memory_order_relaxed);
  entry.client.store(facts.client, std::memory_order_relaxed);
  entry.pid.store(facts.pid, std::memory_order_relaxed);
  entry.uid.store(facts.uid, std::memory_order_relaxed);
  detail::store_name(entry.topic, facts.topic);
  detail::store_name(entry.type, facts.type);
  detail::store_name(entry.node, facts.node);
  detail::store_name(entry.process, facts.process);
  // [sync:graph] release; pairs with the reader's acquire of the word.
  entry.word.store(facts.generation, std::memory_order_release);
}

/// Reader. Returns nothing if the entry has no endpoint, or changes meanwhile.
inline std::optional<GraphFacts> load_entry(const abi::GraphEntry& entry) noexcept {
  GraphFacts facts;
  // [sync:graph] acquire; pairs with the writer's last store.
  facts.generation = entry.word.load(std::memory_order_acquire);
  if (facts.generation == 0) return std::nullopt;
  facts.kind = static_cast<abi::wire::Kind>(entry.kind.load(std::memory_order_relaxed));
  facts.domain = entry.domain.load(std::memory_order_relaxed);
  facts.layout_hash = entry.layout_hash.load(std::memory_order_relaxed);
  facts.qos.policies = entry.policies.load(std::memory_order_relaxed);
  facts.qos.deadline_ns = entry.deadline_ns.load(std::memory_order_relaxed);
  facts.qos.lifespan_ns = entry.lifespan_ns.load(std::memory_order_relaxed);
  facts.qos.lease_ns = entry.lease_ns.load(std::memory_order_relaxed);
  facts.client = entry.client.load(std::memory_order_relaxed);
  facts.pid = entry.pid.load(std::memory_order_relaxed);
  facts.uid = entry.uid.load(std::memory_order_relaxed);
  detail::load_name(entry.topic, facts.topic);
  detail::load_name(entry.type, facts.type);
  detail::load_name(entry.node, facts.node);
  detail::load_name(entry.process, facts.process);
  // [sync:graph] behind the other words; pairs with the writer's fence.
  std::atomic_thread_fence(std::memory_order_acquire);
  if (entry.word.load(std::memory_order_relaxed) != facts.generation) return std::nullopt;
  return facts;
}

}  // namespace agnocast::region
