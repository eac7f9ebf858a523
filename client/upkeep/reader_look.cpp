// SPDX-License-Identifier: Apache-2.0

#include <client/shares/machine_memory.hpp>
#include <client/upkeep/reader_look.hpp>

#include <algorithm>
#include <map>
#include <span>
#include <utility>
#include <vector>

namespace agnocast {

namespace wire = abi::wire;

namespace {

// Interval between looks at readers. A look visits every message that others keep.
constexpr std::chrono::seconds look_pause{1};
// See ReaderShares.
constexpr std::uint64_t memory_divisor = 4;

/// What the readers of one user keep of one publisher's messages, and which readers these are.
struct KeptOfPublisher {
  std::shared_ptr<PublisherEndpoint> publisher;
  std::vector<PublisherEndpoint::Core::EndpointId> readers;
  std::uint64_t bytes;
};

struct Kept {
  std::map<std::uint32_t, std::vector<KeptOfPublisher>> users;  // by uid
  std::uint64_t together = 0;                                   // shared messages count once
};

Kept kept_by_others(const std::vector<std::shared_ptr<PublisherEndpoint>>& publishers) {
  Kept kept;
  std::vector<PublisherEndpoint::Reader> readers;
  for (const auto& publisher : publishers) {
    publisher->list_foreign_readers(readers);
    std::map<std::uint32_t, std::vector<PublisherEndpoint::Core::EndpointId>> by_user;
    std::vector<PublisherEndpoint::Core::EndpointId> all;
    for (const auto& reader : readers) {
      by_user[reader.uid].push_back(reader.id);
      all.push_back(reader.id);
    }
    kept.together += publisher->kept_bytes(all);
    for (auto& [uid, ids] : by_user) {
      const std::uint64_t bytes = publisher->kept_bytes(ids);
      kept.users[uid].push_back({publisher, std::move(ids), bytes});
    }
  }
  return kept;
}

/// Withdraws the readers that keep most, until less than half of the user's share is kept.
void withdraw_largest(const std::vector<KeptOfPublisher>& kept, std::uint64_t share) {
  struct One {
    std::uint64_t bytes;
    PublisherEndpoint* publisher;
    PublisherEndpoint::Core::EndpointId reader;
  };
  std::vector<One> all;
  for (const KeptOfPublisher& part : kept) {
    for (const auto& reader : part.readers)
      all.push_back({part.publisher->kept_bytes({&reader, 1}), part.publisher.get(), reader});
  }
  std::sort(all.begin(), all.end(), [](const One& a, const One& b) { return a.bytes > b.bytes; });
  std::uint64_t left = 0;
  for (const One& one : all) left += one.bytes;
  for (const One& one : all) {
    if (one.bytes == 0 || left < share / 2) return;
    one.publisher->withdraw(one.reader);
    left -= one.bytes;
  }
}

}  // namespace

void ReaderLook::look(const EndpointTable& endpoints, const OwnHeap& heap, Connection& connection) {
  const auto now = ReaderShares::Clock::now();
  if (now - looked_ < look_pause) return;
  looked_ = now;
  const auto all = endpoints.publishers();
  withdraw_above(heap, all, now);
  look_at_each(connection, all, now);
  unmapped_users_.look(now);
}

/// Withdraws readers of users that keep more than their share.
void ReaderLook::withdraw_above(const OwnHeap& heap, const Publishers& all,
                                ReaderShares::Clock::time_point now) {
  const Kept kept = kept_by_others(all);
  std::vector<ReaderShares::Held> users;
  for (const auto& [uid, parts] : kept.users) {
    users.push_back({uid, 0});
    for (const KeptOfPublisher& part : parts) users.back().bytes += part.bytes;
  }
  if (users.empty()) {
    shares_.nobody_reads(now);
  } else {
    static const std::uint64_t most = machine_memory_bytes() / memory_divisor;
    const Heap::Room room = heap.opened().room();
    const bool may_grow = !heap.growth().is_refused() && !heap.opened().has_last_window();
    const ReaderShares::Room bounded{room.refused, may_grow, room.bytes,
                                     std::min(room.bytes_max, most)};
    for (const auto& above : shares_.look(now, bounded, kept.together, users))
      withdraw_largest(kept.users.at(above.uid), above.share);
  }
}

/// Reports to the daemon which readers each publisher no longer serves, or serves again.
void ReaderLook::look_at_each(Connection& connection, const Publishers& all,
                              ReaderShares::Clock::time_point now) {
  std::vector<PublisherEndpoint::Withdrawn> news;
  for (const auto& publisher : all) {
    news.clear();
    publisher->look_at_readers(now, shares_, unmapped_users_, news);
    for (const PublisherEndpoint::Withdrawn& withdrawn : news) {
      wire::Withdrawn body{};
      body.topic = publisher->topic_index();
      body.why = static_cast<std::uint32_t>(withdrawn.why);
      body.publisher = publisher->identity().index;
      body.publisher_generation = publisher->identity().generation;
      body.subscription = withdrawn.index;
      body.subscription_generation = withdrawn.generation;
      body.bytes = withdrawn.bytes;
      connection.post(wire::Opcode::withdrawn, body);
    }
  }
}

}  // namespace agnocast
