// SPDX-License-Identifier: Apache-2.0
//
// Tables: all decisions of the daemon, as plain data in one sealed memfd that outlives its
// process.
//
//   header · client[2048] · topic[4096] · publisher[4096][2048] · subscription[4096][2048]
//
// An endpoint's record has the same place as its board entry, so nothing is searched or moved. The
// memfd is sparse: a page on which every record is free has no memory (the daemon gives it back
// with the last record), and no code may read an unused place (reading a hole would allocate it).
// So each topic has one bit for each of its places. A record of zero bytes is free. Only records
// of the redo log change a table (registry_apply.cpp), with one exception: names are written into
// a free place first, and the record that follows makes the place count.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/abi/observe.hpp>
#include <agnocast/abi/wire.hpp>
#include <journal/announce_set.hpp>
#include <journal/record.hpp>

#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace agnocast::daemon {

enum class ClientIndex : std::uint32_t {};
enum class TopicIndex : std::uint32_t {};
constexpr std::uint32_t number(ClientIndex index) noexcept {
  return static_cast<std::uint32_t>(index);
}
constexpr std::uint32_t number(TopicIndex index) noexcept {
  return static_cast<std::uint32_t>(index);
}

using AnnounceSet = journal::AnnounceSet<SharedMemory>;

enum class ClientState : std::uint32_t {
  free = 0,
  alive = 1,
  dead = 2,       // without a session; its holds and links are being undone
  forgotten = 3,  // undone; peers may still map its region
};
enum class TopicState : std::uint32_t { free = 0, used = 1 };

using journal::EndpointState;

struct WindowRecord {
  std::uint64_t base;
  std::uint64_t bytes;
  std::uint64_t first;  // number of the first window of its window set
};

struct ClientRecord {
  std::uint64_t generation;
  ClientState state;
  std::uint32_t uid;
  std::uint32_t gid;
  std::uint32_t pid;  // as the daemon sees it; 0 when it does not
  // Set when dead or forgotten. A revoked process keeps its place until it has ended too: until
  // then it maps its memory and must be refused when it comes back.
  journal::DeathReason reason;
  std::uint64_t domain;
  std::uint64_t wait_sets;  // one bit each
  std::uint64_t since_ns;   // CLOCK_MONOTONIC of its hello
  std::uint64_t readers;    // who may read its heap, from readers_of(); 0: it never published
  std::uint64_t window_count;
  WindowRecord window[abi::window_count_max];
  AnnounceSet notified;  // peers that have its region and windows
  char name[abi::wire::name_bytes];
};
static_assert(abi::wait_set_count_max < 64, "the wait sets of a client are one word of bits");

/// Which places of a topic are in use: one bit each.
template <std::uint32_t capacity>
using PlaceBits = std::uint64_t[(capacity + 63) / 64];

struct TopicRecord {
  std::uint64_t generation;
  TopicState state;
  // One more than the highest index ever used, as on the board: publishers remember endpoints up
  // to there. Only they walk so far.
  std::uint32_t publisher_high;
  std::uint32_t subscription_high;
  std::uint32_t link_blocks;  // of its subscriptions
  PlaceBits<abi::publisher_count_max> publishers;
  PlaceBits<abi::subscription_count_max> subscriptions;
  std::uint64_t domain;
  std::uint64_t layout_hash;
  char name[abi::wire::name_bytes];
  char type[abi::wire::name_bytes];
};

struct PublisherRecord {
  std::uint64_t generation;
  EndpointState state;
  ClientIndex client;
  abi::QosWords qos;
  std::uint64_t extent;
  std::uint64_t slot_count;
  std::uint64_t final_head;   // of an orphan
  std::uint64_t creation;     // id of the request that created it
  std::uint64_t last_joined;  // orphan: subscriptions of later generations joined after its end
  AnnounceSet notified;
  char node[abi::wire::name_bytes];
};

struct SubscriptionRecord {
  std::uint64_t generation;
  EndpointState state;
  ClientIndex client;
  abi::QosWords qos;
  std::uint64_t extent;
  std::uint64_t quota;
  std::uint64_t wait_set;
  std::uint64_t creation;         // id of the request that created it
  std::uint64_t quota_of_others;  // messages of a publisher of another user
  AnnounceSet notified;
  char node[abi::wire::name_bytes];
};
inline bool matches(const PublisherRecord& publisher,
                    const SubscriptionRecord& subscription) noexcept {
  return abi::endpoints_match(
      {abi::unpack_qos(publisher.qos), static_cast<std::uint64_t>(publisher.client)},
      {abi::unpack_qos(subscription.qos), static_cast<std::uint64_t>(subscription.client)});
}
static_assert(std::is_trivially_copyable_v<ClientRecord> &&
              std::is_trivially_copyable_v<PublisherRecord> &&
              std::is_trivially_copyable_v<SubscriptionRecord> &&
              std::is_trivially_copyable_v<TopicRecord>);
static_assert(std::is_standard_layout_v<ClientRecord> &&
              std::is_standard_layout_v<PublisherRecord>);

/// A path that fits into a socket's address together with the name of a doorbell.
inline constexpr std::size_t doorbells_bytes_max = 108;

struct TableHeader {
  std::uint64_t magic;
  std::uint64_t layout;           // sizes of the records; another build's tables do not fit
  std::uint64_t last_generation;  // one counter for everything; 48 bits last for millennia
  std::uint32_t client_high;
  std::uint32_t topic_high;
  // Decided once for the whole incarnation, whatever a later configuration says.
  std::uint64_t arena_base;
  std::uint64_t arena_bytes;
  std::uint64_t window_bytes;
  std::uint64_t began_ns;  // CLOCK_MONOTONIC
  abi::wire::DaemonCounters counters;
  char doorbells[doorbells_bytes_max];  // directory of the doorbells
};

struct Tables {
  TableHeader header;
  ClientRecord client[abi::client_count_max];
  TopicRecord topic[abi::topic_count_max];
  PublisherRecord publisher[abi::topic_count_max][abi::publisher_count_max];
  SubscriptionRecord subscription[abi::topic_count_max][abi::subscription_count_max];
};

inline constexpr std::uint64_t tables_bytes =
    (sizeof(Tables) + abi::page_bytes - 1) / abi::page_bytes * abi::page_bytes;

}  // namespace agnocast::daemon
