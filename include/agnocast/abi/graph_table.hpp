// SPDX-License-Identifier: Apache-2.0
//
// Graph table: every endpoint that takes part, with its names, for processes that watch the graph.
// One memfd, written by the daemon alone, mapped read-only. Each daemon process makes its own, for
// the first process that asks, and rebuilds it from its tables.
//
//      0  GraphHeader, in a page of its own
//   4096  GraphEntry[entry_high], in no order; the file grows with them
#pragma once

#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/limits.hpp>
#include <agnocast/abi/wire.hpp>

#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace agnocast::abi {

//    0  magic        u64 · 8  fingerprint  u64 · 16  incarnation  u64    written before anybody sees it
//   24  changes      u64  raised after the entries of each change  [sync:graph] release
//   32  entry_high   u64  entries ever used: bound of every loop over them; raised once the file
//                         has memory for them, release
//   40  missing      u64  endpoints that have no entry, for want of room or memory
struct GraphHeader {
  SharedWord magic;
  SharedWord fingerprint;
  SharedWord incarnation;
  SharedWord changes;
  SharedWord entry_high;
  SharedWord missing;
};
inline constexpr std::uint64_t graph_magic = 0x68706172672e6761;  // "ag.graph" in memory order
static_assert(sizeof(GraphHeader) == 48 && sizeof(GraphHeader) <= page_bytes);

/// Words that hold one wire::Name.
inline constexpr std::size_t graph_name_words = wire::name_bytes / sizeof(std::uint64_t);

//    0  word         u64  generation of the endpoint; 0 = no endpoint, or being written
//                         [sync:graph] 0 before the other words, the generation after them
//    8  kind         u64  wire::Kind: publisher or subscription
//   16  domain       u64
//   24  layout_hash  u64  of the type
//   32  policies     u64 · 40  deadline_ns  u64 · 48  lifespan_ns  u64 · 56  lease_ns  u64    QosWords
//   64  client       u64  generation of its process
//   72  pid          u64  as the daemon sees it; 0 when it does not
//   80  uid          u64
//   88  reserved     u64[5]
//  128  topic, type, node, process    256 bytes each, as wire::Name
struct alignas(cache_line_bytes) GraphEntry {
  SharedWord word;
  SharedWord kind;
  SharedWord domain;
  SharedWord layout_hash;
  SharedWord policies;
  SharedWord deadline_ns;
  SharedWord lifespan_ns;
  SharedWord lease_ns;
  SharedWord client;
  SharedWord pid;
  SharedWord uid;
  SharedWord reserved[5];
  SharedWord topic[graph_name_words];
  SharedWord type[graph_name_words];
  SharedWord node[graph_name_words];
  SharedWord process[graph_name_words];
};
static_assert(sizeof(GraphEntry) == 1152 && offsetof(GraphEntry, policies) == 32 &&
              offsetof(GraphEntry, client) == 64 && offsetof(GraphEntry, topic) == 128 &&
              offsetof(GraphEntry, process) == 896);
static_assert(std::is_standard_layout_v<GraphEntry>);

constexpr std::uint64_t graph_entry_offset(std::uint64_t index) noexcept {
  return page_bytes + index * sizeof(GraphEntry);
}
// Entries are backed in blocks of whole pages.
inline constexpr std::uint64_t graph_block_entries = 64;
static_assert(graph_block_entries * sizeof(GraphEntry) % page_bytes == 0 &&
              graph_entry_max % graph_block_entries == 0);
inline constexpr std::uint64_t graph_bytes_max = graph_entry_offset(graph_entry_max);

}  // namespace agnocast::abi
