// SPDX-License-Identifier: Apache-2.0

#include <daemon/registry.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/check.hpp>

#include <algorithm>
#include <bit>
#include <cstring>

namespace agnocast::daemon {
namespace {

constexpr std::uint64_t magic_value = 0x6c6261742e6f6761;  // "ago.tabl" in memory order
constexpr std::uint64_t layout_of_tables = sizeof(ClientRecord) << 48 | sizeof(TopicRecord) << 32 |
                                           sizeof(PublisherRecord) << 16 |
                                           sizeof(SubscriptionRecord);

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
  std::memcpy(to, text.data(), count);
  std::memset(to + count, 0, size - count);
}

tl::unexpected<Failure> full(const char* key, std::uint64_t limit) {
  return fail_with(Errc::limit_reached, std::string("[limits] ") + key + " is " +
                                            std::to_string(limit) + ", as many are there");
}

bool counts_as_member(EndpointState state) noexcept {
  return state == EndpointState::active || state == EndpointState::leaving;
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

void Registry::create(std::uint64_t incarnation) {
  log_.create(abi::fingerprint(), incarnation);
  tables_.header.magic = magic_value;
  tables_.header.layout = layout_of_tables;
}

bool Registry::open() {
  if (!log_.is_valid(abi::fingerprint()) || tables_.header.magic != magic_value ||
      tables_.header.layout != layout_of_tables)
    return false;
  if (const auto record = log_.pending()) {
    apply(*record);
    log_.applied();
  }
  rebuild();
  return true;
}

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
    case Type::revoke_subscription:
    case Type::free_window:
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
      topic.generation = record.argument[1];
      topic.domain = record.argument[2];
      topic.layout_hash = record.argument[3];
      topic.publisher_high = 0;
      topic.subscription_high = 0;
      topic.state = TopicState::used;
      tables_.header.topic_high = std::max(tables_.header.topic_high, number(at) + 1);
      note_generation(topic.generation);
      const auto line = words(at);
      line.publisher_high().store(0, std::memory_order_relaxed);
      line.subscription_high().store(0, std::memory_order_relaxed);
      topics_.insert_or_assign(topic_key(topic.domain, topic.name), at);
      break;
    }
    case Type::free_topic: {
      TopicRecord& topic = tables_.topic[number(topic_of(record))];
      topics_.erase(topic_key(topic.domain, topic.name));
      topic.state = TopicState::free;
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
      told(ref).tell(to);
      const ClientIndex owner = owner_of(ref);
      if (number(owner) != to) tables_.client[number(owner)].told.tell(to);
      break;
    }
    case Type::unlinked: {
      const auto kind = static_cast<Kind>(record.argument[3]);
      const std::uint64_t by = record.argument[2];
      AnnounceSet& set = kind == Kind::region ? tables_.client[record.argument[0]].told
                                              : told({kind, topic_of(record), index_of(record)});
      set.let_go(by, set.generation());
      break;
    }
  }
}

void Registry::apply_to_client(const Record& record) {
  ClientRecord& client = tables_.client[record.argument[0]];
  switch (record.type) {
    case Type::register_client:
      client.generation = record.argument[1];
      client.uid = static_cast<std::uint32_t>(record.argument[2]);
      client.gid = static_cast<std::uint32_t>(record.argument[3]);
      client.pid = static_cast<std::uint32_t>(record.argument[4]);
      client.domain = record.argument[5];
      client.executors = 0;
      client.window_count = 0;
      client.told.begin(client.generation);
      client.state = ClientState::alive;
      tables_.header.client_high =
          std::max(tables_.header.client_high, static_cast<std::uint32_t>(record.argument[0]) + 1);
      note_generation(client.generation);
      break;
    case Type::open_window:
      client.window[record.argument[1]] = {record.argument[2], record.argument[3]};
      client.window_count = std::max(client.window_count, record.argument[1] + 1);
      break;
    case Type::open_executor:
      client.executors |= std::uint64_t{1} << record.argument[1];
      break;
    case Type::client_dead:
      client.state = ClientState::dead;
      break;
    case Type::client_forgotten: {
      const std::uint64_t gone = record.argument[0];
      for (std::uint32_t i = 0; i < tables_.header.client_high; ++i) {
        if (tables_.client[i].state != ClientState::free) tables_.client[i].told.died(gone);
      }
      for (std::uint32_t t = 0; t < tables_.header.topic_high; ++t) {
        const TopicRecord& topic = tables_.topic[t];
        if (topic.state == TopicState::free) continue;
        for (std::uint32_t i = 0; i < topic.publisher_high; ++i)
          tables_.publisher[t][i].told.died(gone);
        for (std::uint32_t i = 0; i < topic.subscription_high; ++i)
          tables_.subscription[t][i].told.died(gone);
      }
      break;
    }
    default:  // client_end
      client.state = ClientState::free;
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
      publisher.generation = argument[2];
      publisher.client = static_cast<ClientIndex>(argument[3]);
      publisher.qos = argument[4];
      publisher.extent = argument[5];
      publisher.slot_count = argument[6];
      publisher.creation = argument[7];
      publisher.last_joined = 0;
      publisher.told.begin(publisher.generation);
      publisher.state = EndpointState::active;
      topic.publisher_high = std::max(topic.publisher_high, index + 1);
      note_generation(publisher.generation);
      track({Kind::publisher, at, index});
      board(at).add_publisher(
          index, publisher.generation,
          {abi::unpack_qos(publisher.qos), number(publisher.client), publisher.extent,
           publisher.slot_count, abi::first_sequence_of(publisher.generation)});
      break;
    case Type::raise_slots:
      publisher.slot_count = std::max(publisher.slot_count, argument[2]);
      words(at)
          .publisher(index, offsetof(abi::PublisherEntry, slot_count))
          .store(publisher.slot_count, std::memory_order_release);
      break;
    case Type::leave_publisher:
      publisher.state = EndpointState::orphan;
      publisher.last_joined = argument[3];
      board(at).orphan_publisher(index, publisher.generation, argument[2]);
      break;
    case Type::free_publisher: {
      const auto state = static_cast<EndpointState>(argument[2]);
      publisher.state = state;
      board(at).free_publisher(index, publisher.generation);
      if (state == EndpointState::free) untrack({Kind::publisher, at, index});
      break;
    }
    case Type::add_subscription:
      subscription.generation = argument[2];
      subscription.client = static_cast<ClientIndex>(argument[3]);
      subscription.qos = argument[4];
      subscription.extent = argument[5];
      subscription.quota = argument[6];
      subscription.executor = argument[7];
      subscription.creation = argument[8];
      subscription.told.begin(subscription.generation);
      subscription.state = EndpointState::active;
      topic.subscription_high = std::max(topic.subscription_high, index + 1);
      note_generation(subscription.generation);
      track({Kind::subscription, at, index});
      board(at).add_subscription(index, subscription.generation,
                                 {abi::unpack_qos(subscription.qos), number(subscription.client),
                                  subscription.extent, subscription.quota, subscription.executor});
      break;
    case Type::leave_subscription: {
      const auto state = static_cast<EndpointState>(argument[2]);
      subscription.state = state;
      board(at).set_subscription(index, subscription.generation,
                                 state == EndpointState::leaving ? abi::MemberState::leaving
                                 : state == EndpointState::dead  ? abi::MemberState::dead
                                                                 : abi::MemberState::free);
      break;
    }
    default:  // free_subscription
      subscription.state = EndpointState::free;
      board(at).set_subscription(index, subscription.generation, abi::MemberState::free);
      untrack({Kind::subscription, at, index});
      break;
  }
}

void Registry::note_generation(std::uint64_t generation) noexcept {
  tables_.header.last_generation = std::max(tables_.header.last_generation, generation);
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

Result<ClientIndex> Registry::add_client(const NewClient& wanted) {
  std::uint32_t index = 0;
  while (index < client_high() && tables_.client[index].state != ClientState::free) ++index;
  if (index >= capacity_.clients) return full("clients", capacity_.clients);
  AGNOCAST_CHECK(views_[index].endpoints.empty());
  put(tables_.client[index].name, wanted.name);
  change(Type::register_client,
         {index, next_generation(), wanted.uid, wanted.gid, wanted.pid, wanted.domain});
  return static_cast<ClientIndex>(index);
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
  change(Type::open_window, {number(index), client(index).window_count, window.base, window.bytes});
}

void Registry::open_executor(ClientIndex index, std::uint32_t executor) {
  AGNOCAST_CHECK(is_alive(index));
  AGNOCAST_CHECK(executor < abi::executor_count_max);
  change(Type::open_executor, {number(index), executor});
}

void Registry::client_died(ClientIndex index) {
  AGNOCAST_CHECK(client(index).state != ClientState::free);
  change(Type::client_dead, {number(index)});
}

void Registry::client_forgotten(ClientIndex index) {
  AGNOCAST_CHECK(client(index).state == ClientState::dead);
  change(Type::client_forgotten, {number(index)});
}

bool Registry::can_end(ClientIndex index) const {
  return client(index).state == ClientState::dead && endpoints_of(index).empty() &&
         client(index).told.reusable();
}

void Registry::end_client(ClientIndex index) {
  AGNOCAST_CHECK(can_end(index));
  change(Type::client_end, {number(index)});
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
  change(Type::free_topic, {number(index)});
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
  change(Type::raise_slots, {number(topic), raise.index, raise.slot_count});
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

void Registry::orphan_publisher(TopicIndex topic, std::uint32_t index, std::uint64_t final_head) {
  AGNOCAST_CHECK(publisher(topic, index).state == EndpointState::active);
  change(Type::leave_publisher, {number(topic), index, final_head, tables_.header.last_generation});
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
  change(Type::free_publisher, {number(topic), index, static_cast<std::uint64_t>(state)});
}

void Registry::change_subscription(TopicIndex topic, std::uint32_t index, EndpointState state) {
  AGNOCAST_CHECK(subscription(topic, index).state != EndpointState::free);
  change(Type::leave_subscription, {number(topic), index, static_cast<std::uint64_t>(state)});
}

void Registry::free_subscription(TopicIndex topic, std::uint32_t index) {
  AGNOCAST_CHECK(subscription(topic, index).told.reusable());
  change(Type::free_subscription, {number(topic), index});
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
         {number(ref.topic), ref.index, number(to), static_cast<std::uint64_t>(ref.kind)});
}

void Registry::let_go(const EndpointRef& ref, ClientIndex by) {
  if (!told_of(ref).contains(number(by))) return;
  change(Type::unlinked,
         {number(ref.topic), ref.index, number(by), static_cast<std::uint64_t>(ref.kind)});
}

void Registry::let_go_of_region(ClientIndex owner, ClientIndex by) {
  if (!client(owner).told.contains(number(by))) return;
  change(Type::unlinked, {number(owner), 0, number(by), static_cast<std::uint64_t>(Kind::region)});
}

}  // namespace agnocast::daemon
