// SPDX-License-Identifier: Apache-2.0

#include <daemon/observers/graph_table.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/clock.hpp>
#include <base/memory/memfd.hpp>
#include <base/memory/populate.hpp>
#include <daemon/state/memory_reserve.hpp>
#include <daemon/transport/request_reading.hpp>
#include <region/graph_entry.hpp>

#include <sys/mman.h>
#include <unistd.h>

#include <atomic>
#include <new>
#include <utility>

namespace agnocast::daemon {
namespace {

// Interval of attempts to give entries to missing endpoints.
constexpr std::uint64_t retry_ms = 1'000;

std::uint64_t place_of(const EndpointRef& ref) noexcept {
  return (std::uint64_t{number(ref.topic)} << 32 | ref.index) << 1 |
         (ref.kind == Kind::publisher ? 0 : 1);
}

template <class Record>
region::GraphFacts facts_of(const Registry& registry, const EndpointRef& ref,
                            const Record& record) noexcept {
  const TopicRecord& topic = registry.topic(ref.topic);
  const ClientRecord& client = registry.client(record.client);
  region::GraphFacts facts;
  facts.generation = record.generation;
  facts.kind = ref.kind;
  facts.domain = topic.domain;
  facts.layout_hash = topic.layout_hash;
  facts.qos = record.qos;
  facts.client = client.generation;
  facts.pid = client.pid;
  facts.uid = client.uid;
  facts.topic = copy_of(topic.name);
  facts.type = copy_of(topic.type);
  facts.node = copy_of(record.node);
  facts.process = copy_of(client.name);
  return facts;
}

bool takes_part(const Registry& registry, const EndpointRef& ref) noexcept {
  if (!registry.is_used(ref)) return false;
  const auto is_active = [&](const auto& record) {
    return record.state == EndpointState::active && registry.is_alive(record.client);
  };
  return ref.kind == Kind::publisher ? is_active(registry.publisher(ref.topic, ref.index))
                                     : is_active(registry.subscription(ref.topic, ref.index));
}

}  // namespace

abi::GraphHeader& GraphTable::header() const noexcept {
  return *reinterpret_cast<abi::GraphHeader*>(mapping_.base());
}
abi::GraphEntry& GraphTable::entry(std::uint32_t index) const noexcept {
  return *reinterpret_cast<abi::GraphEntry*>(mapping_.base() + abi::graph_entry_offset(index));
}
std::uint64_t GraphTable::changes() const noexcept {
  return header().changes.load(std::memory_order_relaxed);
}

Result<void> GraphTable::open() {
  if (is_open()) return {};
  auto writer = make_memfd("agnocast-graph", abi::page_bytes, Length::may_grow);
  if (!writer) return tl::unexpected(writer.error());
  auto reader = reopen_read_only(writer->get());
  if (!reader) return tl::unexpected(reader.error());
  auto mapping = Mapping::map(writer->get(), abi::graph_bytes_max, Mapping::Access::read_write);
  if (!mapping) return tl::unexpected(mapping.error());
  if (auto backed = populate(mapping->base(), abi::page_bytes); !backed) return backed;
  SharedFd shared = share(std::move(*reader));
  MemoryReserve::no_return();
  reader_ = std::move(shared);
  writer_ = std::move(*writer);
  mapping_ = std::move(*mapping);
  header().magic.store(abi::graph_magic, std::memory_order_relaxed);
  header().fingerprint.store(abi::fingerprint(), std::memory_order_relaxed);
  header().incarnation.store(registry_.incarnation(), std::memory_order_relaxed);
  number_ = monotonic_ns();
  registry_.note_changed_endpoints();
  fill();
  header().missing.store(missing_.size(), std::memory_order_relaxed);
  return {};
}

void GraphTable::fill() {
  for (std::uint32_t i = 0; i < registry_.topic_high(); ++i) {
    const TopicIndex topic{i};
    if (registry_.topic(topic).state != TopicState::used) continue;
    registry_.for_each_publisher(topic, [&](std::uint32_t index, const PublisherRecord&) {
      follow({Kind::publisher, topic, index});
    });
    registry_.for_each_subscription(topic, [&](std::uint32_t index, const SubscriptionRecord&) {
      follow({Kind::subscription, topic, index});
    });
  }
}

bool GraphTable::update(std::uint64_t now_ms) {
  if (!is_open()) return false;
  bool is_new = false;
  for (const EndpointRef& ref : registry_.take_changed_endpoints()) is_new |= follow(ref);
  if (!missing_.empty() && now_ms - retried_ms_ >= retry_ms) {
    retried_ms_ = now_ms;
    std::size_t before = missing_.size() + 1;
    while (!missing_.empty() && missing_.size() < std::exchange(before, missing_.size())) {
      const EndpointRef ref = missing_.begin()->second;
      is_new |= follow(ref);
    }
  }
  header().missing.store(missing_.size(), std::memory_order_relaxed);
  if (!is_new) return false;
  // [sync:graph] release, behind the entries: a reader that has seen it reads them.
  header().changes.store(changes() + 1, std::memory_order_release);
  return true;
}

// Returns whether the endpoint's entry has changed.
bool GraphTable::follow(const EndpointRef& ref) {
  const Place place = place_of(ref);
  if (!takes_part(registry_, ref)) {
    missing_.erase(place);
    return remove(place);
  }
  try {
    const MemoryReserve::MayFail may_fail;
    if (entries_.count(place) != 0 || has_room()) return put(ref);
  } catch (const std::bad_alloc&) {
    remove(place);
  }
  return missing_.insert_or_assign(place, ref).second;
}

bool GraphTable::put(const EndpointRef& ref) {
  const region::GraphFacts facts =
      ref.kind == Kind::publisher
          ? facts_of(registry_, ref, registry_.publisher(ref.topic, ref.index))
          : facts_of(registry_, ref, registry_.subscription(ref.topic, ref.index));
  const auto known = entries_.find(place_of(ref));
  if (known != entries_.end()) {
    abi::GraphEntry& present = entry(known->second);
    if (present.word.load(std::memory_order_relaxed) == facts.generation) return false;
    region::store_entry(present, facts);
    return true;
  }
  const std::uint32_t index = free_entry();
  entries_.emplace(place_of(ref), index);
  free_.pop_back();
  missing_.erase(place_of(ref));
  region::store_entry(entry(index), facts);
  return true;
}

bool GraphTable::remove(Place place) {
  const auto known = entries_.find(place);
  if (known == entries_.end()) return false;
  region::clear_entry(entry(known->second));
  free_.push_back(known->second);
  entries_.erase(known);
  return true;
}

bool GraphTable::has_room() const noexcept {
  return !free_.empty() ||
         header().entry_high.load(std::memory_order_relaxed) + abi::graph_block_entries <=
             entries_max_;
}

// Returns the last of the free entries, of which has_room() has one. Throws std::bad_alloc.
std::uint32_t GraphTable::free_entry() {
  if (free_.empty()) grow();
  return free_.back();
}

void GraphTable::grow() {
  const auto high = static_cast<std::uint32_t>(header().entry_high.load(std::memory_order_relaxed));
  free_.reserve(high + abi::graph_block_entries);  // so that remove() needs no memory
  const std::uint64_t begin = abi::graph_entry_offset(high);
  const std::uint64_t bytes = abi::graph_block_entries * sizeof(abi::GraphEntry);
  if (!lengthen(writer_.get(), begin + bytes) || !populate(mapping_.base() + begin, bytes))
    throw std::bad_alloc();
  for (std::uint32_t i = abi::graph_block_entries; i-- > 0;) free_.push_back(high + i);
  // Release: a reader that has seen it may touch the entries.
  header().entry_high.store(high + abi::graph_block_entries, std::memory_order_release);
}

}  // namespace agnocast::daemon
