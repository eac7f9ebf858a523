// SPDX-License-Identifier: Apache-2.0

#include <daemon/registry.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/check.hpp>
#include <base/step.hpp>

#include <algorithm>
#include <bit>
#include <cstring>

namespace agnocast::daemon {
namespace {

// A pass may be left out so many times (docs/protocol.md, lazy pass); what these publishes would
// have freed needs a slot each.
constexpr std::uint64_t lazy_pass_count = 32;
// One for the message being published and one for the one being borrowed.
constexpr std::uint64_t slots_in_hand = 2;
// What every publisher gets: until its control thread has mapped a new subscription, it keeps all
// messages for it, so a busy process needs a reserve. Up to here hold bits cost nothing more.
constexpr std::uint64_t slots_at_least = abi::near_slot_count;

constexpr std::uint64_t round_up(std::uint64_t value, std::uint64_t unit) noexcept {
  return (value + unit - 1) / unit * unit;
}

template <std::size_t size>
void put(char (&to)[size], std::string_view text) noexcept {
  const std::size_t count = std::min(text.size(), size - 1);
  AGNOCAST_CRASH_POINT(B_name);
  std::memcpy(to, text.data(), count);
  AGNOCAST_CRASH_POINT(B_name);
  std::memset(to + count, 0, size - count);
}

/// Every number of the tables is stored here: one place where the sweep may kill before each.
template <class Field>
void store(Field& field, const std::type_identity_t<Field>& value) noexcept {
  AGNOCAST_CRASH_POINT(B_table);
  field = value;
}

void forget(AnnounceSet& told, std::uint64_t gone) noexcept {
  AGNOCAST_CRASH_POINT(B_told);
  told.died(gone);
}

tl::unexpected<Failure> full(const char* key, std::uint64_t limit) {
  return fail_with(Errc::limit_reached, std::string("[limits] ") + key + " is " +
                                            std::to_string(limit) + ", as many are there");
}

bool counts_as_member(EndpointState state) noexcept {
  return state == EndpointState::active || state == EndpointState::leaving;
}

using journal::DeathReason;
using journal::LeaveCause;

std::uint64_t& death_counter(abi::wire::DaemonCounters& counters, DeathReason reason) noexcept {
  switch (reason) {
    case DeathReason::let_go:
      return counters.clients_let_go;
    case DeathReason::revoked:
      return counters.clients_revoked;
    case DeathReason::died:
      break;
  }
  return counters.clients_died;
}

std::uint64_t* intent_counter(abi::wire::DaemonCounters& counters, LeaveCause cause) noexcept {
  switch (cause) {
    case LeaveCause::rolled_back:
      return &counters.intents_rolled_back;
    case LeaveCause::rolled_forward:
      return &counters.intents_rolled_forward;
    case LeaveCause::corrupt:
      return &counters.intents_corrupt;
    case LeaveCause::left:
    case LeaveCause::nothing_open:
      break;
  }
  return nullptr;
}

TopicIndex topic_of(const journal::Record& record) noexcept {
  return static_cast<TopicIndex>(record.argument[0]);
}
std::uint32_t index_of(const journal::Record& record) noexcept {
  return static_cast<std::uint32_t>(record.argument[1]);
}

}  // namespace

std::string topic_key(std::uint64_t domain, std::string_view name) {
  return std::to_string(domain).append(name);  // a name starts with a slash
}

Registry::Registry(const Memory& memory, const Capacity& capacity) noexcept
    : capacity_(capacity),
      log_(memory.log),
      tables_(*reinterpret_cast<Tables*>(memory.tables)),
      board_(memory.board),
      views_(abi::client_count_max) {}

void Registry::rebuild() {
  topics_.clear();
  views_.assign(abi::client_count_max, View());
  for (std::uint32_t t = 0; t < tables_.header.topic_high; ++t) {
    const TopicIndex at{t};
    if (topic(at).state == TopicState::free) continue;
    topics_.emplace(topic_key(topic(at).domain, topic(at).name), at);
    for_each_publisher(at, [&](std::uint32_t i, const PublisherRecord&) {
      track({Kind::publisher, at, i});
    });
    for_each_subscription(at, [&](std::uint32_t i, const SubscriptionRecord&) {
      track({Kind::subscription, at, i});
    });
  }
}

// --- the one way to change anything

void Registry::change(Type type, std::initializer_list<std::uint64_t> arguments) {
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
      apply_to_counters(record);
      break;
    case Type::register_client:
    case Type::open_window:
    case Type::open_executor:
    case Type::client_dead:
    case Type::client_forgotten:
    case Type::client_end:
      apply_to_client(record);
      break;
    case Type::add_topic: {
      const TopicIndex at = topic_of(record);
      TopicRecord& topic = tables_.topic[number(at)];
      store(topic.generation, record.argument[1]);
      store(topic.domain, record.argument[2]);
      store(topic.layout_hash, record.argument[3]);
      store(topic.publisher_high, 0);
      store(topic.subscription_high, 0);
      store(topic.state, TopicState::used);
      store(tables_.header.topic_high, std::max(tables_.header.topic_high, number(at) + 1));
      note_generation(topic.generation);
      const auto line = words(at);
      AGNOCAST_CRASH_POINT(B_board_field);
      line.publisher_high().store(0, std::memory_order_relaxed);
      AGNOCAST_CRASH_POINT(B_board_field);
      line.subscription_high().store(0, std::memory_order_relaxed);
      topics_.insert_or_assign(topic_key(topic.domain, topic.name), at);
      break;
    }
    case Type::free_topic: {
      TopicRecord& topic = tables_.topic[number(topic_of(record))];
      topics_.erase(topic_key(topic.domain, topic.name));
      store(topic.state, TopicState::free);
      break;
    }
    case Type::add_publisher:
    case Type::add_subscription:
    case Type::raise_slots:
    case Type::leave_publisher:
    case Type::free_publisher:
    case Type::leave_subscription:
    case Type::free_subscription:
      apply_to_endpoint(record);
      break;
    case Type::announced: {
      const EndpointRef ref{static_cast<Kind>(record.argument[3]), topic_of(record),
                            index_of(record)};
      const std::uint64_t to = record.argument[2];
      AGNOCAST_CRASH_POINT(B_told);
      told(ref).tell(to);
      const ClientIndex owner = owner_of(ref);
      if (number(owner) == to) break;
      AGNOCAST_CRASH_POINT(B_told);
      tables_.client[number(owner)].told.tell(to);
      break;
    }
    case Type::unlinked: {
      const auto kind = static_cast<Kind>(record.argument[3]);
      const std::uint64_t by = record.argument[2];
      AnnounceSet& set = kind == Kind::region ? tables_.client[record.argument[0]].told
                                              : told({kind, topic_of(record), index_of(record)});
      AGNOCAST_CRASH_POINT(B_told);
      set.let_go(by, set.generation());
      break;
    }
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
      store(client.executors, 0);
      store(client.window_count, 0);
      AGNOCAST_CRASH_POINT(B_told);
      client.told.begin(client.generation);
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
    case Type::open_executor:
      store(client.executors, client.executors | std::uint64_t{1} << record.argument[1]);
      break;
    case Type::client_dead:
      store(client.reason, static_cast<DeathReason>(record.argument[2]));
      // What was revoked is forgotten already when it ends.
      store(client.state, std::max(client.state, ClientState::dead));
      store(death_counter(tables_.header.counters, static_cast<DeathReason>(record.argument[2])),
            record.argument[3]);
      break;
    case Type::client_forgotten: {
      const std::uint64_t gone = record.argument[0];
      for (std::uint32_t i = 0; i < tables_.header.client_high; ++i) {
        if (tables_.client[i].state != ClientState::free) forget(tables_.client[i].told, gone);
      }
      for (std::uint32_t t = 0; t < tables_.header.topic_high; ++t) {
        const TopicRecord& topic = tables_.topic[t];
        if (topic.state == TopicState::free) continue;
        for (std::uint32_t i = 0; i < topic.publisher_high; ++i)
          forget(tables_.publisher[t][i].told, gone);
        for (std::uint32_t i = 0; i < topic.subscription_high; ++i)
          forget(tables_.subscription[t][i].told, gone);
      }
      store(client.state, ClientState::forgotten);
      break;
    }
    default:  // client_end
      store(client.state, ClientState::free);
      break;
  }
}

void Registry::apply_to_endpoint(const Record& record) {
  const TopicIndex at = topic_of(record);
  const std::uint32_t index = index_of(record);
  TopicRecord& topic = tables_.topic[number(at)];
  PublisherRecord& publisher =
      tables_.publisher[number(at)][std::min(index, abi::publisher_count_max - 1)];
  SubscriptionRecord& subscription = tables_.subscription[number(at)][index];
  const std::uint64_t* const argument = record.argument;
  switch (record.type) {
    case Type::add_publisher:
      store(publisher.generation, argument[2]);
      store(publisher.client, static_cast<ClientIndex>(argument[3]));
      store(publisher.qos, argument[4]);
      store(publisher.extent, argument[5]);
      store(publisher.slot_count, argument[6]);
      store(publisher.final_head, 0);
      store(publisher.creation, argument[7]);
      store(publisher.last_joined, 0);
      AGNOCAST_CRASH_POINT(B_told);
      publisher.told.begin(publisher.generation);
      store(publisher.state, EndpointState::active);
      store(topic.publisher_high, std::max(topic.publisher_high, index + 1));
      note_generation(publisher.generation);
      track({Kind::publisher, at, index});
      board(at).add_publisher(
          index, publisher.generation,
          {abi::unpack_qos(publisher.qos), number(publisher.client), publisher.extent,
           publisher.slot_count, abi::first_sequence_of(publisher.generation)});
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
    case Type::free_publisher: {
      const auto state = static_cast<EndpointState>(argument[2]);
      store(publisher.state, state);
      board(at).free_publisher(index, publisher.generation);
      if (state == EndpointState::free) untrack({Kind::publisher, at, index});
      break;
    }
    case Type::add_subscription:
      store(subscription.generation, argument[2]);
      store(subscription.client, static_cast<ClientIndex>(argument[3]));
      store(subscription.qos, argument[4]);
      store(subscription.extent, argument[5]);
      store(subscription.quota, argument[6]);
      store(subscription.executor, argument[7]);
      store(subscription.creation, argument[8]);
      AGNOCAST_CRASH_POINT(B_told);
      subscription.told.begin(subscription.generation);
      store(subscription.state, EndpointState::active);
      store(topic.subscription_high, std::max(topic.subscription_high, index + 1));
      note_generation(subscription.generation);
      track({Kind::subscription, at, index});
      board(at).add_subscription(index, subscription.generation,
                                 {abi::unpack_qos(subscription.qos), number(subscription.client),
                                  subscription.extent, subscription.quota, subscription.executor});
      break;
    case Type::leave_subscription: {
      const auto state = static_cast<EndpointState>(argument[2]);
      store(subscription.state, state);
      board(at).set_subscription(index, subscription.generation, on_board(state));
      break;
    }
    default:  // free_subscription
      store(subscription.state, EndpointState::free);
      board(at).set_subscription(index, subscription.generation, abi::MemberState::free);
      untrack({Kind::subscription, at, index});
      break;
  }
}

void Registry::apply_to_counters(const Record& record) {
  abi::wire::DaemonCounters& counters = tables_.header.counters;
  if (record.type == Type::recovered) {
    store(counters.restarts, record.argument[5]);
    store(counters.clients_died_meanwhile, record.argument[6]);
  } else {
    store(counters.clients_rejoined, record.argument[2]);
  }
}

void Registry::note_recovered(const Recovered& facts) {
  change(Type::recovered,
         {facts.pid, facts.away_ns, redone_lsn_, facts.dead_count, facts.board_word_count,
          counters().restarts + 1, counters().clients_died_meanwhile + facts.dead_count});
}

void Registry::note_rejoined(ClientIndex index) {
  change(Type::rejoined,
         {number(index), client(index).generation, counters().clients_rejoined + 1});
}

void Registry::note_generation(std::uint64_t generation) noexcept {
  store(tables_.header.last_generation, std::max(tables_.header.last_generation, generation));
}

// --- derived

void Registry::track(const EndpointRef& ref) {
  View& view = views_[number(owner_of(ref))];
  if (std::find(view.endpoints.begin(), view.endpoints.end(), ref) != view.endpoints.end()) return;
  view.endpoints.push_back(ref);
  if (ref.kind == Kind::publisher) {
    view.extents[publisher(ref.topic, ref.index).extent] = abi::publisher_extent_bytes;
  } else {
    view.extents[subscription(ref.topic, ref.index).extent] = abi::subscription_extent_bytes;
  }
}

void Registry::untrack(const EndpointRef& ref) {
  View& view = views_[number(owner_of(ref))];
  const auto found = std::find(view.endpoints.begin(), view.endpoints.end(), ref);
  if (found == view.endpoints.end()) return;
  view.endpoints.erase(found);
  view.extents.erase(ref.kind == Kind::publisher ? publisher(ref.topic, ref.index).extent
                                                 : subscription(ref.topic, ref.index).extent);
}

std::optional<std::uint64_t> Registry::lowest_extent(ClientIndex client,
                                                     std::uint64_t bytes) const {
  std::uint64_t candidate = abi::page_bytes;  // behind the header
  for (const auto& [offset, length] : views_[number(client)].extents) {
    if (offset - candidate >= bytes) break;
    candidate = offset + length;
  }
  if (candidate + bytes > client_region_bytes) return std::nullopt;
  return candidate;
}

// --- processes

Result<ClientPlan> Registry::plan_client() const {
  std::uint32_t index = 0;
  while (index < client_high() && tables_.client[index].state != ClientState::free) ++index;
  if (index >= capacity_.clients) return full("clients", capacity_.clients);
  AGNOCAST_CHECK(views_[index].endpoints.empty());
  return ClientPlan{static_cast<ClientIndex>(index), next_generation()};
}

void Registry::add_client(const NewClient& wanted, const ClientPlan& plan) {
  ClientRecord& record = tables_.client[number(plan.index)];
  AGNOCAST_CHECK(record.state == ClientState::free);
  put(record.name, wanted.name);
  change(Type::register_client, {number(plan.index), plan.generation, wanted.uid, wanted.gid,
                                 wanted.pid, wanted.domain, counters().clients_registered + 1});
}

Result<ClientIndex> Registry::add_client(const NewClient& wanted) {
  const auto plan = plan_client();
  if (!plan) return tl::unexpected(plan.error());
  add_client(wanted, *plan);
  return plan->index;
}

Usage Registry::usage_of(std::uint32_t uid) const {
  Usage usage;
  for (std::uint32_t i = 0; i < client_high(); ++i) {
    const ClientRecord& record = tables_.client[i];
    if (record.state == ClientState::free || record.uid != uid) continue;
    ++usage.clients;
    for (const EndpointRef& ref : views_[i].endpoints) {
      ++(ref.kind == Kind::publisher ? usage.publishers : usage.subscriptions);
      if (ref.kind == Kind::subscription)
        usage.held_messages += subscription(ref.topic, ref.index).quota;
    }
    usage.executors += static_cast<std::uint64_t>(std::popcount(record.executors));
    for (std::uint64_t w = 0; w < record.window_count; ++w)
      usage.heap_bytes += record.window[w].bytes;
  }
  return usage;
}

void Registry::open_window(ClientIndex index, const WindowRecord& window) {
  AGNOCAST_CHECK(is_alive(index));
  AGNOCAST_CHECK(client(index).window_count < abi::window_count_max);
  change(Type::open_window, {number(index), client(index).window_count, window.base, window.bytes,
                             client(index).generation, window.first});
}

void Registry::open_executor(ClientIndex index, std::uint32_t executor) {
  AGNOCAST_CHECK(is_alive(index));
  AGNOCAST_CHECK(executor < abi::executor_count_max);
  change(Type::open_executor, {number(index), executor, client(index).generation});
}

void Registry::client_died(ClientIndex index, DeathReason reason) {
  AGNOCAST_CHECK(is_alive(index) || is_revoked(index));
  // It was counted when it was revoked.
  const std::uint64_t more = is_revoked(index) ? 0 : 1;
  change(Type::client_dead,
         {number(index), client(index).generation, static_cast<std::uint64_t>(reason),
          death_counter(counters(), reason) + more});
}

void Registry::client_forgotten(ClientIndex index) {
  AGNOCAST_CHECK(client(index).state == ClientState::dead);
  change(Type::client_forgotten, {number(index), client(index).generation});
}

bool Registry::can_end(ClientIndex index) const {
  return client(index).state == ClientState::forgotten && !is_revoked(index) &&
         endpoints_of(index).empty() && client(index).told.reusable();
}

void Registry::end_client(ClientIndex index) {
  AGNOCAST_CHECK(can_end(index));
  change(Type::client_end, {number(index), client(index).generation});
}

// --- topics

std::optional<TopicIndex> Registry::find_topic(std::uint64_t domain, std::string_view name) const {
  const auto found = topics_.find(topic_key(domain, name));
  if (found == topics_.end()) return std::nullopt;
  return found->second;
}

Result<TopicIndex> Registry::add_topic(const NewTopic& wanted) {
  AGNOCAST_CHECK(!find_topic(wanted.domain, wanted.name));
  std::uint32_t index = 0;
  while (index < topic_high() && tables_.topic[index].state != TopicState::free) ++index;
  if (index >= capacity_.topics) return full("topics", capacity_.topics);
  put(tables_.topic[index].name, wanted.name);
  put(tables_.topic[index].type, wanted.type);
  change(Type::add_topic, {index, next_generation(), wanted.domain, wanted.layout_hash});
  return static_cast<TopicIndex>(index);
}

bool Registry::topic_is_empty(TopicIndex index) const {
  bool empty = true;
  for_each_publisher(index, [&](std::uint32_t, const PublisherRecord&) { empty = false; });
  for_each_subscription(index, [&](std::uint32_t, const SubscriptionRecord&) { empty = false; });
  return empty;
}

void Registry::free_topic(TopicIndex index) {
  AGNOCAST_CHECK(topic(index).state == TopicState::used);
  AGNOCAST_CHECK(topic_is_empty(index));
  change(Type::free_topic, {number(index), topic(index).generation});
}

// --- endpoints

// N >= max(K, deepest window) + every hold quota + what lazy passes leave + what is in hand: then
// no reader can make the publisher run out (docs/protocol.md, slots). Whole words of hold bits.
std::uint64_t Registry::slots_needed(TopicIndex topic, const abi::Qos& offered,
                                     const SubscriptionRecord* joining) const {
  std::uint64_t window = offered.depth;
  std::uint64_t quotas = 0;
  const auto count = [&](const SubscriptionRecord& record) {
    const abi::Qos requested = abi::unpack_qos(record.qos);
    if (!abi::qos_match(offered, requested)) return;
    window = std::max<std::uint64_t>(window, abi::window_of(requested));
    quotas += record.quota;
  };
  for_each_subscription(topic, [&](std::uint32_t, const SubscriptionRecord& record) {
    if (counts_as_member(record.state)) count(record);
  });
  if (joining != nullptr) count(*joining);
  const std::uint64_t slots = round_up(window + quotas + lazy_pass_count + slots_in_hand, 64);
  return std::min<std::uint64_t>(std::max(slots, slots_at_least), capacity_.slots_per_publisher);
}

Result<PublisherPlan> Registry::plan_publisher(ClientIndex client, TopicIndex topic,
                                               const abi::Qos& qos) const {
  PublisherPlan plan;
  const std::uint32_t high = this->topic(topic).publisher_high;
  while (plan.index < high && publisher(topic, plan.index).state != EndpointState::free)
    ++plan.index;
  if (plan.index >= capacity_.publishers_per_topic)
    return full("publishers_per_topic", capacity_.publishers_per_topic);
  const auto extent = lowest_extent(client, abi::publisher_extent_bytes);
  if (!extent)
    return fail(Errc::limit_reached, "the region of the process has no room for another endpoint");
  plan.generation = next_generation();
  plan.extent = *extent;
  plan.slot_count = slots_needed(topic, qos, nullptr);
  plan.first_sequence = abi::first_sequence_of(plan.generation);
  return plan;
}

void Registry::add_publisher(ClientIndex client, TopicIndex topic, const abi::Qos& qos,
                             const PublisherPlan& plan, std::string_view node,
                             std::uint64_t creation) {
  PublisherRecord& record = tables_.publisher[number(topic)][plan.index];
  AGNOCAST_CHECK(is_alive(client));
  AGNOCAST_CHECK(record.state == EndpointState::free);
  AGNOCAST_CHECK(record.told.reusable());
  put(record.node, node);
  change(Type::add_publisher, {number(topic), plan.index, plan.generation, number(client),
                               abi::pack_qos(qos), plan.extent, plan.slot_count, creation});
}

Result<SubscriptionPlan> Registry::plan_subscription(ClientIndex client, TopicIndex topic,
                                                     const abi::Qos& qos,
                                                     std::uint64_t quota) const {
  SubscriptionPlan plan;
  const std::uint32_t high = this->topic(topic).subscription_high;
  while (plan.index < high && subscription(topic, plan.index).state != EndpointState::free)
    ++plan.index;
  if (plan.index >= capacity_.subscriptions_per_topic)
    return full("subscriptions_per_topic", capacity_.subscriptions_per_topic);
  const auto extent = lowest_extent(client, abi::subscription_extent_bytes);
  if (!extent)
    return fail(Errc::limit_reached, "the region of the process has no room for another endpoint");
  plan.generation = next_generation();
  plan.extent = *extent;
  SubscriptionRecord joining{};
  joining.qos = abi::pack_qos(qos);
  joining.quota = quota;
  for_each_publisher(topic, [&](std::uint32_t index, const PublisherRecord& record) {
    if (record.state != EndpointState::active) return;
    const std::uint64_t needed = slots_needed(topic, abi::unpack_qos(record.qos), &joining);
    if (needed > record.slot_count) plan.raises.push_back({index, needed});
  });
  return plan;
}

void Registry::raise_slots(TopicIndex topic, const SlotRaise& raise) {
  AGNOCAST_CHECK(raise.slot_count <= abi::slot_count_max);
  const EndpointRef ref{Kind::publisher, topic, raise.index};
  change(Type::raise_slots,
         {number(topic), raise.index, raise.slot_count, generation_of(ref), number(owner_of(ref))});
}

void Registry::add_subscription(ClientIndex client, TopicIndex topic, const abi::Qos& qos,
                                std::uint64_t quota, std::uint64_t executor,
                                const SubscriptionPlan& plan, std::string_view node,
                                std::uint64_t creation) {
  SubscriptionRecord& record = tables_.subscription[number(topic)][plan.index];
  AGNOCAST_CHECK(is_alive(client));
  AGNOCAST_CHECK(record.state == EndpointState::free);
  AGNOCAST_CHECK(record.told.reusable());
  put(record.node, node);
  change(Type::add_subscription, {number(topic), plan.index, plan.generation, number(client),
                                  abi::pack_qos(qos), plan.extent, quota, executor, creation});
}

std::optional<EndpointRef> Registry::find_creation(ClientIndex client, Kind kind,
                                                   std::uint64_t creation) const {
  for (const EndpointRef& ref : endpoints_of(client)) {
    if (ref.kind == kind &&
        creation == (kind == Kind::publisher ? publisher(ref.topic, ref.index).creation
                                             : subscription(ref.topic, ref.index).creation))
      return ref;
  }
  return std::nullopt;
}

void Registry::orphan_publisher(TopicIndex topic, std::uint32_t index, std::uint64_t final_head,
                                LeaveCause cause) {
  const PublisherRecord& record = publisher(topic, index);
  AGNOCAST_CHECK(record.state == EndpointState::active);
  const std::uint64_t* const counter = intent_counter(counters(), cause);
  change(Type::leave_publisher,
         {number(topic), index, final_head, record.generation, number(record.client),
          static_cast<std::uint64_t>(cause), counter == nullptr ? 0 : *counter + 1,
          tables_.header.last_generation});
}

std::uint64_t Registry::final_head_of(TopicIndex topic, std::uint32_t index) const noexcept {
  return words(topic)
      .publisher(index, offsetof(abi::PublisherEntry, final_head))
      .load(std::memory_order_relaxed);
}

void Registry::end_publisher(TopicIndex topic, std::uint32_t index, EndpointState state) {
  AGNOCAST_CHECK(publisher(topic, index).state == EndpointState::orphan ||
                 publisher(topic, index).state == EndpointState::over);
  AGNOCAST_CHECK(publisher(topic, index).told.reusable());
  const PublisherRecord& record = publisher(topic, index);
  change(Type::free_publisher, {number(topic), index, static_cast<std::uint64_t>(state),
                                record.generation, number(record.client)});
}

void Registry::change_subscription(TopicIndex topic, std::uint32_t index, EndpointState state) {
  AGNOCAST_CHECK(subscription(topic, index).state != EndpointState::free);
  const SubscriptionRecord& record = subscription(topic, index);
  change(Type::leave_subscription, {number(topic), index, static_cast<std::uint64_t>(state),
                                    record.generation, number(record.client)});
}

void Registry::free_subscription(TopicIndex topic, std::uint32_t index) {
  AGNOCAST_CHECK(subscription(topic, index).told.reusable());
  const SubscriptionRecord& record = subscription(topic, index);
  change(Type::free_subscription, {number(topic), index, record.generation, number(record.client)});
}

bool Registry::uses_far_slots(TopicIndex topic) const {
  bool uses = false;
  for_each_publisher(topic, [&](std::uint32_t, const PublisherRecord& record) {
    uses = uses || record.slot_count > abi::near_slot_count;
  });
  return uses;
}

// --- rule RU

AnnounceSet& Registry::told(const EndpointRef& ref) noexcept {
  return ref.kind == Kind::publisher ? tables_.publisher[number(ref.topic)][ref.index].told
                                     : tables_.subscription[number(ref.topic)][ref.index].told;
}
const AnnounceSet& Registry::told_of(const EndpointRef& ref) const noexcept {
  return ref.kind == Kind::publisher ? publisher(ref.topic, ref.index).told
                                     : subscription(ref.topic, ref.index).told;
}
ClientIndex Registry::owner_of(const EndpointRef& ref) const noexcept {
  return ref.kind == Kind::publisher ? publisher(ref.topic, ref.index).client
                                     : subscription(ref.topic, ref.index).client;
}
std::uint64_t Registry::generation_of(const EndpointRef& ref) const noexcept {
  return ref.kind == Kind::publisher ? publisher(ref.topic, ref.index).generation
                                     : subscription(ref.topic, ref.index).generation;
}

void Registry::tell(const EndpointRef& ref, ClientIndex to) {
  // A repeated announcement changes nothing; the log is for what changes.
  if (told_of(ref).contains(number(to)) &&
      (owner_of(ref) == to || client(owner_of(ref)).told.contains(number(to))))
    return;
  change(Type::announced,
         {number(ref.topic), ref.index, number(to), static_cast<std::uint64_t>(ref.kind),
          generation_of(ref), number(owner_of(ref)), client(to).generation});
}

void Registry::let_go(const EndpointRef& ref, ClientIndex by) {
  if (!told_of(ref).contains(number(by))) return;
  change(Type::unlinked,
         {number(ref.topic), ref.index, number(by), static_cast<std::uint64_t>(ref.kind),
          generation_of(ref), number(owner_of(ref)), client(by).generation});
}

void Registry::let_go_of_region(ClientIndex owner, ClientIndex by) {
  if (!client(owner).told.contains(number(by))) return;
  change(Type::unlinked, {number(owner), 0, number(by), static_cast<std::uint64_t>(Kind::region),
                          client(owner).generation, number(owner), client(by).generation});
}

}  // namespace agnocast::daemon
