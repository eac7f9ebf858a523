// SPDX-License-Identifier: Apache-2.0
//
// Tables: everything the daemon has decided, as plain data in one sealed memfd that outlives its
// process.
//
//   header · client[2048] · topic[4096] · publisher[4096][254] · subscription[4096][768]
//
// An endpoint's record lies at the place its board entry has, so nothing is searched and nothing is
// moved. The memfd is sparse: a page on which every record is free has no memory (it is given back
// when the last of them is freed), and nobody looks at a place that is not in use (a read of a hole
// would allocate it): each topic has one bit for each of its places. A record of zero bytes is a
// free one. Only the redo log's records change a table (registry_apply.cpp); names are the
// exception: they are written into a free place first, and the record that follows makes the place
// count.
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
  dead = 2,       // without a session; what it had and knew is being undone
  forgotten = 3,  // that is done; others may still have its region
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
  // When dead or forgotten. What was revoked keeps its place until it ends as well: so long it maps
  // its memory, and so long it is known that it may not come back.
  journal::DeathReason reason;
  std::uint64_t domain;
  std::uint64_t executors;  // one bit each
  std::uint64_t since_ns;   // CLOCK_MONOTONIC of its hello
  std::uint64_t readers;    // who may read its heap, as readers_of() says it; 0: it never published
  std::uint64_t window_count;
  WindowRecord window[abi::window_count_max];
  AnnounceSet notified;  // who has its region and windows
  char name[abi::wire::name_bytes];
};
static_assert(abi::executor_count_max < 64, "the executors of a client are one word of bits");

/// Which places of a topic are in use: one bit each.
template <std::uint32_t capacity>
using PlaceBits = std::uint64_t[(capacity + 63) / 64];

struct TopicRecord {
  std::uint64_t generation;
  TopicState state;
  // One more than the highest index ever used, as the board has it: publishers remember endpoints
  // up to there. Nobody else walks so far.
  std::uint32_t publisher_high;
  std::uint32_t subscription_high;
  std::uint32_t reserved;
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
  std::uint64_t qos;
  std::uint64_t extent;
  std::uint64_t slot_count;
  std::uint64_t final_head;   // of an orphan
  std::uint64_t creation;     // id of the request that created it
  std::uint64_t last_joined;  // orphan: subscriptions of a later generation came after its end
  AnnounceSet notified;
  char node[abi::wire::name_bytes];
};

struct SubscriptionRecord {
  std::uint64_t generation;
  EndpointState state;
  ClientIndex client;
  std::uint64_t qos;
  std::uint64_t extent;
  std::uint64_t quota;
  std::uint64_t executor;
  std::uint64_t creation;         // id of the request that created it
  std::uint64_t quota_of_others;  // messages of a publisher of another user
  AnnounceSet notified;
  char node[abi::wire::name_bytes];
};
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
  std::uint64_t layout;           // sizes of the records: another build's tables are not ours
  std::uint64_t last_generation;  // one counter for everything; 48 bits last for millennia
  std::uint32_t client_high;
  std::uint32_t topic_high;
  // What was decided once for the whole incarnation, whatever a later configuration says.
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
