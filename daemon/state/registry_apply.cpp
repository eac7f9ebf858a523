// SPDX-License-Identifier: Apache-2.0
//
// Registry, the one way to change anything: a record is committed to the redo log and then
// applied. If the daemon dies in between, the next one applies it again, so each of these
// functions is repeatable: it stores what the record says and never adds to what it finds.

#include <base/check.hpp>
#include <daemon/state/memory_reserve.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/state/registry_counters.hpp>
#include <daemon/state/steps.hpp>
#include <journal/steps.hpp>

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cstddef>
#include <type_traits>

namespace agnocast::daemon {
namespace {

using journal::DeathReason;
using journal::LeaveCause;

/// Stores every number of the tables: one place where the crash sweep may kill before each store.
template <class Field>
void store(Field& field, const std::type_identity_t<Field>& value) noexcept {
  AGNOCAST_CRASH_POINT(B_table);
  field = value;
}

TopicIndex topic_of(const journal::Record& record) noexcept {
  return static_cast<TopicIndex>(record.argument[0]);
}
std::uint32_t index_of(const journal::Record& record) noexcept {
  return static_cast<std::uint32_t>(record.argument[1]);
}

}  // namespace

// --- the one way to change anything

void Registry::change(Type type, std::initializer_list<std::uint64_t> arguments) {
  MemoryReserve::no_return();
  const std::uint64_t lsn = log_.commit(type, arguments.begin(), arguments.size());
  const auto record = log_.read(lsn);
  AGNOCAST_CHECK(record.has_value());
  apply(*record);
  log_.applied();
}

void Registry::apply(const Record& record) {
  switch (record.type) {
    case Type::none:
      break;
    case Type::recovered:
    case Type::rejoined:
    case Type::reader_withdrawn:
    case Type::reader_served_again:
    case Type::reader_mute:
      apply_to_counters(record);
      break;
    case Type::register_client:
    case Type::open_window:
    case Type::open_wait_set:
    case Type::readers:
    case Type::client_dead:
    case Type::client_forgotten:
    case Type::client_end:
      apply_to_client(record);
      break;
    case Type::add_topic:
    case Type::free_topic:
      apply_to_topic(record);
      break;
    case Type::add_publisher:
    case Type::raise_slots:
    case Type::leave_publisher:
    case Type::free_publisher:
      apply_to_publisher(record);
      note_change({Kind::publisher, topic_of(record), index_of(record)});
      break;
    case Type::add_subscription:
    case Type::leave_subscription:
    case Type::free_subscription:
      apply_to_subscription(record);
      note_change({Kind::subscription, topic_of(record), index_of(record)});
      break;
    case Type::announced:
    case Type::unlinked:
    case Type::topic_forgotten:
      apply_to_announce_sets(record);
      break;
  }
}

void Registry::apply_to_topic(const Record& record) {
  const TopicIndex at = topic_of(record);
  TopicRecord& topic = tables_.topic[number(at)];
  if (record.type == Type::free_topic) {
    topics_.erase(topic_key(topic.domain, topic.name));
    store(topic.state, TopicState::free);
    return;
  }
  store(topic.generation, record.argument[1]);
  store(topic.domain, record.argument[2]);
  store(topic.layout_hash, record.argument[3]);
  store(topic.link_blocks, static_cast<std::uint32_t>(record.argument[4]));
  store(topic.publisher_high, 0);
  store(topic.subscription_high, 0);
  for (std::uint64_t& word : topic.publishers) store(word, 0);
  for (std::uint64_t& word : topic.subscriptions) store(word, 0);
  store(topic.state, TopicState::used);
  store(tables_.header.topic_high, std::max(tables_.header.topic_high, number(at) + 1));
  note_generation(topic.generation);
  const auto line = words(at);
  AGNOCAST_CRASH_POINT(B_board_field);
  line.publisher_high().store(0, std::memory_order_relaxed);
  AGNOCAST_CRASH_POINT(B_board_field);
  line.subscription_high().store(0, std::memory_order_relaxed);
  topics_.insert_or_assign(topic_key(topic.domain, topic.name), at);
}

void Registry::apply_to_announce_sets(const Record& record) {
  const TopicIndex topic = topic_of(record);
  const auto kind = static_cast<Kind>(record.argument[3]);
  const std::uint64_t who = record.argument[record.type == Type::topic_forgotten ? 1 : 2];
  if (record.type == Type::topic_forgotten) {
    for (const Kind each : {Kind::publisher, Kind::subscription}) {
      for_each_place(each, topic, [&](std::uint32_t index) {
        take_from(notified({each, topic, index}), topic, who);
      });
    }
  } else if (record.type == Type::unlinked) {
    if (kind == Kind::region) {
      AnnounceSet& set = tables_.client[record.argument[0]].notified;
      AGNOCAST_CRASH_POINT(B_notified);
      set.acknowledge(who, set.generation());
    } else {
      take_from(notified({kind, topic, index_of(record)}), topic, who);
    }
  } else {
    const EndpointRef ref{kind, topic, index_of(record)};
    add_to(notified(ref), topic, who);
    const ClientIndex owner = owner_of(ref);
    if (number(owner) == who) return;
    AGNOCAST_CRASH_POINT(B_notified);
    tables_.client[number(owner)].notified.notify(who);
  }
}

void Registry::apply_to_client(const Record& record) {
  ClientRecord& client = tables_.client[record.argument[0]];
  switch (record.type) {
    case Type::register_client:
      store(client.generation, record.argument[1]);
      store(client.uid, static_cast<std::uint32_t>(record.argument[2]));
      store(client.gid, static_cast<std::uint32_t>(record.argument[3]));
      store(client.pid, static_cast<std::uint32_t>(record.argument[4]));
      store(client.domain, record.argument[5]);
      store(client.since_ns, record.stamp_ns);
      store(client.wait_sets, 0);
      store(client.readers, 0);
      store(client.window_count, 0);
      AGNOCAST_CRASH_POINT(B_notified);
      client.notified.begin(client.generation);
      store(client.state, ClientState::alive);
      store(tables_.header.counters.clients_registered, record.argument[6]);
      store(
          tables_.header.client_high,
          std::max(tables_.header.client_high, static_cast<std::uint32_t>(record.argument[0]) + 1));
      note_generation(client.generation);
      break;
    case Type::open_window:
      store(client.window[record.argument[1]],
            {record.argument[2], record.argument[3], record.argument[5]});
      store(client.window_count, std::max(client.window_count, record.argument[1] + 1));
      break;
    case Type::open_wait_set:
      store(client.wait_sets, client.wait_sets | std::uint64_t{1} << record.argument[1]);
      break;
    case Type::readers:
      store(client.readers, record.argument[1]);
      break;
    case Type::client_dead:
      store(client.reason, static_cast<DeathReason>(record.argument[2]));
      // A revoked process is already forgotten when it ends.
      store(client.state, std::max(client.state, ClientState::dead));
      store(death_counter(tables_.header.counters, static_cast<DeathReason>(record.argument[2])),
            record.argument[3]);
      for (const EndpointRef& ref : endpoints_of(static_cast<ClientIndex>(record.argument[0])))
        note_change(ref);
      break;
    case Type::client_forgotten: {
      // acknowledge_topic() has removed it from the sets of endpoints.
      const std::uint64_t gone = record.argument[0];
      for (std::uint32_t i = 0; i < tables_.header.client_high; ++i) {
        if (tables_.client[i].state == ClientState::free) continue;
        AGNOCAST_CRASH_POINT(B_notified);
        tables_.client[i].notified.died(gone);
      }
      store(client.state, ClientState::forgotten);
      break;
    }
    default:  // client_end
      store(client.state, ClientState::free);
      break;
  }
  count_client(static_cast<ClientIndex>(record.argument[0]));
}

void Registry::apply_to_publisher(const Record& record) {
  const TopicIndex at = topic_of(record);
  const std::uint32_t index = index_of(record);
  TopicRecord& topic = tables_.topic[number(at)];
  PublisherRecord& publisher = tables_.publisher[number(at)][index];
  const std::uint64_t* const argument = record.argument;
  switch (record.type) {
    case Type::add_publisher:
      store(publisher.generation, argument[2]);
      store(publisher.client, static_cast<ClientIndex>(argument[3]));
      store(publisher.qos.policies, argument[4]);
      store(publisher.extent, argument[5]);
      store(publisher.slot_count, argument[6]);
      store(publisher.final_head, 0);
      store(publisher.creation, argument[7]);
      store(publisher.qos.deadline_ns, argument[8]);
      store(publisher.qos.lifespan_ns, argument[9]);
      store(publisher.qos.lease_ns, argument[10]);
      store(publisher.last_joined, 0);
      AGNOCAST_CRASH_POINT(B_notified);
      publisher.notified.begin(publisher.generation);
      store(publisher.state, EndpointState::active);
      use_place({Kind::publisher, at, index});
      store(topic.publisher_high, std::max(topic.publisher_high, index + 1));
      note_generation(publisher.generation);
      track({Kind::publisher, at, index});
      board(at).add_publisher(index, publisher.generation,
                              {abi::unpack_qos(publisher.qos), number(publisher.client),
                               publisher.extent, publisher.slot_count});
      break;
    case Type::raise_slots:
      store(publisher.slot_count, std::max(publisher.slot_count, argument[2]));
      AGNOCAST_CRASH_POINT(B_board_field);
      words(at)
          .publisher(index, offsetof(abi::PublisherEntry, slot_count))
          .store(publisher.slot_count, std::memory_order_release);
      break;
    case Type::leave_publisher:
      store(publisher.final_head, argument[2]);
      store(publisher.state, EndpointState::orphan);
      store(publisher.last_joined, argument[7]);
      if (std::uint64_t* const counter =
              intent_counter(tables_.header.counters, static_cast<LeaveCause>(argument[5])))
        store(*counter, argument[6]);
      board(at).orphan_publisher(index, publisher.generation, argument[2]);
      break;
    default: {  // free_publisher
      const auto state = static_cast<EndpointState>(argument[2]);
      store(publisher.state, state);
      board(at).free_publisher(index, publisher.generation);
      if (state != EndpointState::free) break;
      untrack({Kind::publisher, at, index});
      vacate_place({Kind::publisher, at, index});
      break;
    }
  }
}

void Registry::apply_to_subscription(const Record& record) {
  const TopicIndex at = topic_of(record);
  const std::uint32_t index = index_of(record);
  TopicRecord& topic = tables_.topic[number(at)];
  SubscriptionRecord& subscription = tables_.subscription[number(at)][index];
  const std::uint64_t* const argument = record.argument;
  switch (record.type) {
    case Type::add_subscription:
      store(subscription.generation, argument[2]);
      store(subscription.client, static_cast<ClientIndex>(argument[3]));
      store(subscription.qos.policies, argument[4]);
      store(subscription.extent, argument[5]);
      store(subscription.quota, argument[6]);
      store(subscription.wait_set, argument[7]);
      store(subscription.creation, argument[8]);
      store(subscription.quota_of_others, argument[9]);
      store(subscription.qos.deadline_ns, argument[10]);
      store(subscription.qos.lifespan_ns, 0);
      store(subscription.qos.lease_ns, argument[11]);
      AGNOCAST_CRASH_POINT(B_notified);
      subscription.notified.begin(subscription.generation);
      store(subscription.state, EndpointState::active);
      use_place({Kind::subscription, at, index});
      store(topic.subscription_high, std::max(topic.subscription_high, index + 1));
      note_generation(subscription.generation);
      track({Kind::subscription, at, index});
      board(at).add_subscription(index, subscription.generation,
                                 {abi::unpack_qos(subscription.qos), number(subscription.client),
                                  subscription.extent, subscription.quota, subscription.wait_set});
      break;
    case Type::leave_subscription: {
      const auto state = static_cast<EndpointState>(argument[2]);
      store(subscription.state, state);
      board(at).set_subscription(index, subscription.generation, on_board(state));
      break;
    }
    default:  // free_subscription
      store(subscription.state, EndpointState::free);
      board(at).set_subscription(index, subscription.generation, abi::BoardState::free);
      untrack({Kind::subscription, at, index});
      vacate_place({Kind::subscription, at, index});
      break;
  }
}

void Registry::note_change(const EndpointRef& ref) {
  if (notes_changes_) changed_.push_back(ref);
}

void Registry::use_place(const EndpointRef& ref) {
  TopicRecord& topic = tables_.topic[number(ref.topic)];
  std::uint64_t* const places =
      ref.kind == Kind::publisher ? topic.publishers : topic.subscriptions;
  store(places[ref.index / 64], places[ref.index / 64] | std::uint64_t{1} << ref.index % 64);
}

bool Registry::has_record_at(Kind kind, std::uint64_t number) const noexcept {
  const std::uint64_t places =
      kind == Kind::publisher ? abi::publisher_count_max : abi::subscription_count_max;
  return is_used({kind, TopicIndex{static_cast<std::uint32_t>(number / places)},
                  static_cast<std::uint32_t>(number % places)});
}

// A page belongs to the records that overlap it, of one topic or two. Partial pages at the
// beginning and the end of the table stay.
void Registry::vacate_place(const EndpointRef& ref) {
  TopicRecord& topic = tables_.topic[number(ref.topic)];
  const bool publisher = ref.kind == Kind::publisher;
  std::uint64_t* const places = publisher ? topic.publishers : topic.subscriptions;
  store(places[ref.index / 64], places[ref.index / 64] & ~(std::uint64_t{1} << ref.index % 64));

  static const std::uint64_t page = static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
  const std::uint64_t table =
      publisher ? offsetof(Tables, publisher) : offsetof(Tables, subscription);
  const std::uint64_t size = publisher ? sizeof(PublisherRecord) : sizeof(SubscriptionRecord);
  const std::uint64_t places_max =
      publisher ? abi::publisher_count_max : abi::subscription_count_max;
  const std::uint64_t end = table + size * places_max * abi::topic_count_max;
  const std::uint64_t begin = table + size * (number(ref.topic) * places_max + ref.index);
  for (std::uint64_t at = begin / page * page; at < begin + size; at += page) {
    if (at < table || at + page > end) continue;
    bool empty = true;
    for (std::uint64_t i = (at - table) / size; empty && table + i * size < at + page; ++i)
      empty = !has_record_at(ref.kind, i);
    // If the system refuses, the page stays and is used again.
    if (empty) ::madvise(reinterpret_cast<std::byte*>(&tables_) + at, page, MADV_REMOVE);
  }
}

void Registry::apply_to_counters(const Record& record) {
  abi::wire::DaemonCounters& counters = tables_.header.counters;
  switch (record.type) {
    case Type::recovered:
      store(counters.restarts, record.argument[4]);
      store(counters.clients_died_meanwhile, record.argument[5]);
      break;
    case Type::rejoined:
      store(counters.clients_rejoined, record.argument[2]);
      break;
    case Type::reader_withdrawn:
      store(counters.readers_withdrawn, record.argument[12]);
      break;
    case Type::reader_served_again:
      store(counters.readers_served_again, record.argument[11]);
      break;
    default:  // reader_mute
      store(counters.readers_mute, record.argument[7]);
      break;
  }
}

void Registry::note_recovered(const Recovered& facts) {
  change(Type::recovered,
         {facts.pid, redone_lsn_, facts.dead_count, facts.board_word_count, counters().restarts + 1,
          counters().clients_died_meanwhile + facts.dead_count});
}

void Registry::note_rejoined(ClientIndex index) {
  change(Type::rejoined,
         {number(index), client(index).generation, counters().clients_rejoined + 1});
}

void Registry::note_withdrawn(const ReaderPair& pair, abi::Withdrawal why) {
  const ClientRecord& owner = client(owner_of(pair.publisher));
  const ClientRecord& reader = client(owner_of(pair.reader));
  change(Type::reader_withdrawn,
         {number(pair.publisher.topic), pair.publisher.index, generation_of(pair.publisher),
          number(owner_of(pair.publisher)), owner.uid, owner.pid, pair.reader.index,
          generation_of(pair.reader), number(owner_of(pair.reader)), reader.uid, reader.pid,
          static_cast<std::uint64_t>(why), counters().readers_withdrawn + 1});
}

void Registry::note_served_again(const ReaderPair& pair) {
  const ClientRecord& owner = client(owner_of(pair.publisher));
  const ClientRecord& reader = client(owner_of(pair.reader));
  change(Type::reader_served_again,
         {number(pair.publisher.topic), pair.publisher.index, generation_of(pair.publisher),
          number(owner_of(pair.publisher)), owner.uid, owner.pid, pair.reader.index,
          generation_of(pair.reader), number(owner_of(pair.reader)), reader.uid, reader.pid,
          counters().readers_served_again + 1});
}

void Registry::note_mute(const EndpointRef& ref) {
  const SubscriptionRecord& record = subscription(ref.topic, ref.index);
  const ClientRecord& owner = client(record.client);
  change(Type::reader_mute, {number(ref.topic), ref.index, record.generation, number(record.client),
                             owner.uid, owner.pid, record.wait_set, counters().readers_mute + 1});
}

void Registry::note_generation(std::uint64_t generation) noexcept {
  store(tables_.header.last_generation, std::max(tables_.header.last_generation, generation));
}

}  // namespace agnocast::daemon
