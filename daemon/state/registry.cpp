// SPDX-License-Identifier: Apache-2.0
//
// Registry, operations: whether there is room, and which record is committed. registry_apply.cpp
// applies records to tables and board; registry_open.cpp starts a daemon's life.

#include <daemon/state/registry.hpp>
#include <daemon/state/registry_counters.hpp>

#include <base/check.hpp>
#include <daemon/state/steps.hpp>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <iterator>
#include <map>

namespace agnocast::daemon {
namespace {

// Every publisher gets at least these: it keeps all messages for a new subscription until its
// control thread has mapped that one, so a busy process needs a reserve. Up to here hold bits are
// free.
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

tl::unexpected<Failure> full(const char* key, std::uint64_t limit) {
  return fail_with(Errc::limit_reached, std::string("[limits] ") + key + " is " +
                                            std::to_string(limit) + ", as many are there");
}

bool counts_as_endpoint(EndpointState state) noexcept {
  return state == EndpointState::active || state == EndpointState::leaving;
}

using journal::DeathReason;
using journal::LeaveCause;
}  // namespace

std::string topic_key(std::uint64_t domain, std::string_view name) {
  return std::to_string(domain).append(name);  // a name starts with a slash
}

Registry::Registry(const Memory& memory, const Capacity& capacity) noexcept
    : capacity_(capacity),
      log_(memory.log),
      tables_(*reinterpret_cast<Tables*>(memory.tables)),
      board_(memory.board) {}

void Registry::rebuild() {
  topics_.clear();
  views_.clear();
  accounts_.clear();
  for (std::uint32_t i = 0; i < client_high(); ++i) count_client(ClientIndex{i});
  for (std::uint32_t t = 0; t < tables_.header.topic_high; ++t) {
    const TopicIndex at{t};
    if (topic(at).state == TopicState::free) continue;
    topics_.emplace(topic_key(topic(at).domain, topic(at).name), at);
    for (const Kind kind : {Kind::publisher, Kind::subscription}) {
      for_each_place(kind, at, [&](std::uint32_t i) {
        const EndpointRef ref{kind, at, i};
        track(ref);
        for (std::uint32_t c = 0; c < client_high(); ++c) {
          if (notified_of(ref).contains(c)) ++views_[ClientIndex{c}].knows[t];
        }
      });
    }
  }
}

// --- derived

// Replaces the previous count, so open() may call it again when it completes a change.
void Registry::count_client(ClientIndex index) {
  const ClientRecord& record = client(index);
  View& view = views_[index];
  accounts_.subtract(view.uid, view.own);
  view.uid = record.uid;
  view.own = Usage();
  if (record.state == ClientState::free) return;
  view.own.clients = 1;
  view.own.wait_sets = static_cast<std::uint64_t>(std::popcount(record.wait_sets));
  // open() completes a change before it checks the tables.
  view.own.windows = std::min<std::uint64_t>(record.window_count, abi::window_count_max);
  for (std::uint64_t w = 0; w < view.own.windows; ++w)
    view.own.heap_bytes += record.window[w].bytes;
  accounts_.add(view.uid, view.own);
}

void Registry::count_endpoint(const EndpointRef& ref, bool is_there) {
  const std::uint64_t held =
      ref.kind == Kind::subscription ? subscription(ref.topic, ref.index).quota : 0;
  const std::uint32_t uid = views_[owner_of(ref)].uid;
  if (is_there) {
    accounts_.add_endpoint(uid, ref.kind, ref.topic, held);
  } else {
    accounts_.remove_endpoint(uid, ref.kind, ref.topic, held);
  }
}

void Registry::track(const EndpointRef& ref) {
  View& view = views_[owner_of(ref)];
  if (std::find(view.endpoints.begin(), view.endpoints.end(), ref) != view.endpoints.end()) return;
  view.endpoints.push_back(ref);
  count_endpoint(ref, true);
  if (ref.kind == Kind::publisher) {
    view.extents[publisher(ref.topic, ref.index).extent] = abi::publisher_extent_bytes;
  } else {
    view.extents[subscription(ref.topic, ref.index).extent] =
        abi::subscription_extent_bytes(topic(ref.topic).link_blocks);
  }
}

void Registry::untrack(const EndpointRef& ref) {
  View& view = views_[owner_of(ref)];
  const auto found = std::find(view.endpoints.begin(), view.endpoints.end(), ref);
  if (found == view.endpoints.end()) return;
  view.endpoints.erase(found);
  count_endpoint(ref, false);
  view.extents.erase(ref.kind == Kind::publisher ? publisher(ref.topic, ref.index).extent
                                                 : subscription(ref.topic, ref.index).extent);
}

void Registry::add_to(AnnounceSet& set, TopicIndex topic, std::uint64_t client) {
  if (set.contains(client)) return;
  ++views_[ClientIndex{static_cast<std::uint32_t>(client)}].knows[number(topic)];
  AGNOCAST_CRASH_POINT(B_notified);
  set.notify(client);
}

void Registry::take_from(AnnounceSet& set, TopicIndex topic, std::uint64_t client) {
  if (!set.contains(client)) return;
  // open() completes a change before it derives these.
  auto& knows = views_[ClientIndex{static_cast<std::uint32_t>(client)}].knows;
  if (const auto known = knows.find(number(topic)); known != knows.end() && --known->second == 0)
    knows.erase(known);
  AGNOCAST_CRASH_POINT(B_notified);
  set.acknowledge(client, set.generation());
}

std::optional<std::uint32_t> Registry::next_place(Kind kind, TopicIndex topic,
                                                  std::uint32_t index) const noexcept {
  const auto places = places_of(kind, topic);
  for (std::uint32_t word = index / 64; word < places.size(); ++word) {
    std::uint64_t rest = places[word];
    if (word == index / 64) rest &= ~std::uint64_t{0} << index % 64;
    if (rest != 0) return word * 64 + static_cast<std::uint32_t>(std::countr_zero(rest));
  }
  return std::nullopt;
}

std::optional<std::uint64_t> Registry::lowest_extent(ClientIndex client,
                                                     std::uint64_t bytes) const {
  std::uint64_t candidate = abi::page_bytes;  // behind the header
  for (const auto& [offset, length] : views_[client].extents) {
    if (offset - candidate >= bytes) break;
    candidate = offset + length;
  }
  if (candidate + bytes > abi::client_region_bytes) return std::nullopt;
  return candidate;
}

// --- processes

Result<ClientPlan> Registry::plan_client() const {
  std::uint32_t index = 0;
  while (index < client_high() && tables_.client[index].state != ClientState::free) ++index;
  if (index >= capacity_.clients) return full("clients", capacity_.clients);
  if (tables_.client[index].state != ClientState::free)
    return fail(Errc::store_damaged, "an unused place for a process is not free");
  AGNOCAST_CHECK(views_[ClientIndex{index}].endpoints.empty());
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

std::uint64_t Registry::used_bytes_of(ClientIndex index) const {
  const auto& extents = views_[index].extents;
  return extents.empty() ? abi::page_bytes : extents.rbegin()->first + extents.rbegin()->second;
}

void Registry::open_window(ClientIndex index, const WindowRecord& window) {
  AGNOCAST_CHECK(is_alive(index));
  AGNOCAST_CHECK(client(index).window_count < abi::window_count_max);
  change(Type::open_window, {number(index), client(index).window_count, window.base, window.bytes,
                             client(index).generation, window.first});
}

void Registry::set_readers(ClientIndex index, std::uint64_t readers) {
  AGNOCAST_CHECK(is_alive(index));
  change(Type::readers, {number(index), readers, client(index).generation});
}

void Registry::open_wait_set(ClientIndex index, std::uint32_t wait_set) {
  AGNOCAST_CHECK(is_alive(index));
  AGNOCAST_CHECK(wait_set < abi::wait_set_count_max);
  change(Type::open_wait_set, {number(index), wait_set, client(index).generation});
}

void Registry::client_died(ClientIndex index, DeathReason reason) {
  AGNOCAST_CHECK(is_alive(index) || is_revoked(index));
  // A revoked process was counted when it was revoked.
  const std::uint64_t more = is_revoked(index) ? 0 : 1;
  change(Type::client_dead,
         {number(index), client(index).generation, static_cast<std::uint64_t>(reason),
          death_counter(counters(), reason) + more});
}

void Registry::acknowledge_topic(ClientIndex gone, TopicIndex topic) {
  AGNOCAST_CHECK(client(gone).state == ClientState::dead);
  if (views_[gone].knows.count(number(topic)) == 0) return;
  change(Type::topic_forgotten, {number(topic), number(gone), client(gone).generation});
}

std::optional<TopicIndex> Registry::known_topic_of(ClientIndex index) const {
  const auto& knows = views_[index].knows;
  if (knows.empty()) return std::nullopt;
  return TopicIndex{knows.begin()->first};
}

void Registry::client_forgotten(ClientIndex index) {
  AGNOCAST_CHECK(client(index).state == ClientState::dead);
  AGNOCAST_CHECK(!known_topic_of(index));
  change(Type::client_forgotten, {number(index), client(index).generation});
}

bool Registry::can_free(ClientIndex index) const {
  return client(index).state == ClientState::forgotten && !is_revoked(index) &&
         endpoints_of(index).empty() && client(index).notified.reusable();
}

void Registry::free_client(ClientIndex index) {
  AGNOCAST_CHECK(can_free(index));
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
  change(Type::add_topic,
         {index, next_generation(), wanted.domain, wanted.layout_hash, wanted.link_blocks});
  return static_cast<TopicIndex>(index);
}

bool Registry::topic_is_empty(TopicIndex index) const {
  return !next_place(Kind::publisher, index, 0) && !next_place(Kind::subscription, index, 0);
}

void Registry::free_topic(TopicIndex index) {
  AGNOCAST_CHECK(topic(index).state == TopicState::used);
  AGNOCAST_CHECK(topic_is_empty(index));
  change(Type::free_topic, {number(index), topic(index).generation});
}

// --- endpoints

// N >= max(K, deepest window) + every hold quota + messages left by deferred scans + messages in
// hand: then no reader can exhaust the publisher's slots (docs/protocol.md, slots). Rounded up to
// whole words of hold bits.
std::uint64_t Registry::slots_needed(TopicIndex topic, const PublisherRecord& publisher,
                                     const SubscriptionRecord* joining) const {
  std::uint64_t window = abi::unpack_qos(publisher.qos).depth;
  std::uint64_t quotas = 0;
  const auto count = [&](const SubscriptionRecord& record) {
    if (!matches(publisher, record)) return;
    window = std::max<std::uint64_t>(window, abi::reach_of(abi::unpack_qos(record.qos)));
    quotas += hold_quota(record, publisher);
  };
  for_each_subscription(topic, [&](std::uint32_t, const SubscriptionRecord& record) {
    if (counts_as_endpoint(record.state)) count(record);
  });
  if (joining != nullptr) count(*joining);
  const std::uint64_t slots =
      round_up(window + quotas + abi::deferred_scan_count_max + slots_in_hand, 64);
  return std::min<std::uint64_t>(std::max(slots, slots_at_least), capacity_.slots_per_publisher);
}

namespace {
// A place without a bit that is not free, or that some process has not acknowledged, is damage
// that open() does not check: such a place is not given out.
template <class Record>
bool is_vacant(const Record& record) noexcept {
  return record.state == EndpointState::free && record.notified.reusable();
}
}  // namespace

Result<PublisherPlan> Registry::plan_publisher(ClientIndex client, TopicIndex topic,
                                               const abi::Qos& qos) const {
  PublisherPlan plan;
  const std::uint32_t high = this->topic(topic).publisher_high;
  while (plan.index < high && (is_used({Kind::publisher, topic, plan.index}) ||
                               !is_vacant(publisher(topic, plan.index))))
    ++plan.index;
  if (plan.index >= capacity_.publishers_per_topic)
    return full("publishers_per_topic", capacity_.publishers_per_topic);
  const std::uint32_t links = this->topic(topic).link_blocks * abi::link_block_count;
  if (plan.index >= links)
    return fail_with(Errc::limit_reached, "the topic has " + std::to_string(links) +
                                              " publishers, as many as one that began without "
                                              "being in [limits] wide_topics may have");
  if (!is_vacant(publisher(topic, plan.index)))
    return fail(Errc::store_damaged, "an unused place of the topic is not free");
  const auto extent = lowest_extent(client, abi::publisher_extent_bytes);
  if (!extent)
    return fail(Errc::limit_reached, "the region of the process has no room for another endpoint");
  plan.generation = next_generation();
  plan.extent = *extent;
  PublisherRecord joining{};
  joining.client = client;
  joining.qos = abi::pack_qos(qos);
  plan.slot_count = slots_needed(topic, joining, nullptr);
  plan.first_sequence = abi::first_sequence_of(plan.generation);
  return plan;
}

void Registry::add_publisher(ClientIndex client, TopicIndex topic, const abi::Qos& qos,
                             const PublisherPlan& plan, std::string_view node,
                             std::uint64_t creation) {
  PublisherRecord& record = tables_.publisher[number(topic)][plan.index];
  AGNOCAST_CHECK(is_alive(client));
  AGNOCAST_CHECK(record.state == EndpointState::free);
  AGNOCAST_CHECK(record.notified.reusable());
  put(record.node, node);
  change(Type::add_publisher,
         {number(topic), plan.index, plan.generation, number(client), abi::pack_policies(qos),
          plan.extent, plan.slot_count, creation, qos.deadline_ns, qos.lifespan_ns, qos.lease_ns});
}

Result<SubscriptionPlan> Registry::plan_subscription(ClientIndex client, TopicIndex topic,
                                                     const abi::Qos& qos,
                                                     const HoldQuota& quota) const {
  SubscriptionPlan plan;
  const std::uint32_t high = this->topic(topic).subscription_high;
  while (plan.index < high && (is_used({Kind::subscription, topic, plan.index}) ||
                               !is_vacant(subscription(topic, plan.index))))
    ++plan.index;
  if (plan.index >= capacity_.subscriptions_per_topic)
    return full("subscriptions_per_topic", capacity_.subscriptions_per_topic);
  if (!is_vacant(subscription(topic, plan.index)))
    return fail(Errc::store_damaged, "an unused place of the topic is not free");
  const auto extent =
      lowest_extent(client, abi::subscription_extent_bytes(this->topic(topic).link_blocks));
  if (!extent)
    return fail(Errc::limit_reached, "the region of the process has no room for another endpoint");
  plan.generation = next_generation();
  plan.extent = *extent;
  SubscriptionRecord joining{};
  joining.qos = abi::pack_qos(qos);
  joining.client = client;
  joining.quota = quota.own;
  joining.quota_of_others = quota.others;
  // Publishers of one user with the same policies need the same, unless a subscription ignores
  // those of its process. On a wide topic there are a thousand of each.
  bool tells_processes_apart = qos.ignore_local;
  for_each_subscription(topic, [&](std::uint32_t, const SubscriptionRecord& record) {
    tells_processes_apart = tells_processes_apart || abi::unpack_qos(record.qos).ignore_local;
  });
  std::map<std::array<std::uint64_t, 6>, std::uint64_t> known;
  for_each_publisher(topic, [&](std::uint32_t index, const PublisherRecord& record) {
    if (record.state != EndpointState::active || record.slot_count >= capacity_.slots_per_publisher)
      return;
    const auto [needed, is_new] = known.try_emplace(
        {uid_of(record.client), tells_processes_apart ? number(record.client) : 0,
         record.qos.policies, record.qos.deadline_ns, record.qos.lifespan_ns, record.qos.lease_ns});
    if (is_new) needed->second = slots_needed(topic, record, &joining);
    if (needed->second > record.slot_count) plan.raises.push_back({index, needed->second});
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
                                const HoldQuota& quota, std::uint64_t wait_set,
                                const SubscriptionPlan& plan, std::string_view node,
                                std::uint64_t creation) {
  SubscriptionRecord& record = tables_.subscription[number(topic)][plan.index];
  AGNOCAST_CHECK(is_alive(client));
  AGNOCAST_CHECK(record.state == EndpointState::free);
  AGNOCAST_CHECK(record.notified.reusable());
  put(record.node, node);
  change(Type::add_subscription,
         {number(topic), plan.index, plan.generation, number(client), abi::pack_policies(qos),
          plan.extent, quota.own, wait_set, creation, quota.others, qos.deadline_ns, qos.lease_ns});
}

HoldPool::Use Registry::pool_use(std::uint32_t uid, TopicIndex topic) const {
  HoldPool::Use use;
  for_each_subscription(topic, [&](std::uint32_t, const SubscriptionRecord& record) {
    // A subscription that is over holds nothing: publishers no longer look at it.
    if (!counts_as_endpoint(record.state)) return;
    (uid_of(record.client) == uid ? use.user : use.others) +=
        std::max<std::uint64_t>(record.quota_of_others, 1) - 1;
  });
  return use;
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
  AGNOCAST_CHECK(publisher(topic, index).notified.reusable());
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
  AGNOCAST_CHECK(subscription(topic, index).notified.reusable());
  const SubscriptionRecord& record = subscription(topic, index);
  change(Type::free_subscription, {number(topic), index, record.generation, number(record.client)});
}

LinkBlocks Registry::slots_by_link_block(TopicIndex topic) const {
  LinkBlocks slots{};
  for_each_publisher(topic, [&](std::uint32_t index, const PublisherRecord& record) {
    std::uint64_t& most = slots[index / abi::link_block_count];
    most = std::max(most, record.slot_count);
  });
  return slots;
}

// --- rule RU

AnnounceSet& Registry::notified(const EndpointRef& ref) noexcept {
  return ref.kind == Kind::publisher ? tables_.publisher[number(ref.topic)][ref.index].notified
                                     : tables_.subscription[number(ref.topic)][ref.index].notified;
}
const AnnounceSet& Registry::notified_of(const EndpointRef& ref) const noexcept {
  return ref.kind == Kind::publisher ? publisher(ref.topic, ref.index).notified
                                     : subscription(ref.topic, ref.index).notified;
}
ClientIndex Registry::owner_of(const EndpointRef& ref) const noexcept {
  return ref.kind == Kind::publisher ? publisher(ref.topic, ref.index).client
                                     : subscription(ref.topic, ref.index).client;
}
std::uint64_t Registry::generation_of(const EndpointRef& ref) const noexcept {
  return ref.kind == Kind::publisher ? publisher(ref.topic, ref.index).generation
                                     : subscription(ref.topic, ref.index).generation;
}

void Registry::notify(const EndpointRef& ref, ClientIndex to) {
  // A repeated announcement changes nothing; the log is for what changes.
  if (notified_of(ref).contains(number(to)) &&
      (owner_of(ref) == to || client(owner_of(ref)).notified.contains(number(to))))
    return;
  change(Type::announced,
         {number(ref.topic), ref.index, number(to), static_cast<std::uint64_t>(ref.kind),
          generation_of(ref), number(owner_of(ref)), client(to).generation});
}

void Registry::acknowledge_unmap(const EndpointRef& ref, ClientIndex by) {
  if (!notified_of(ref).contains(number(by))) return;
  change(Type::unlinked,
         {number(ref.topic), ref.index, number(by), static_cast<std::uint64_t>(ref.kind),
          generation_of(ref), number(owner_of(ref)), client(by).generation});
}

void Registry::acknowledge_region_unmap(ClientIndex owner, ClientIndex by) {
  if (!client(owner).notified.contains(number(by))) return;
  change(Type::unlinked, {number(owner), 0, number(by), static_cast<std::uint64_t>(Kind::region),
                          client(owner).generation, number(owner), client(by).generation});
}

}  // namespace agnocast::daemon
