// SPDX-License-Identifier: Apache-2.0
//
// AddressConflicts: see the header.

#include <daemon/admission/address_conflicts.hpp>

#include <base/check.hpp>
#include <daemon/state/memory_reserve.hpp>
#include <daemon/state/user_log.hpp>

#include <algorithm>

namespace agnocast::daemon {
namespace {

std::uint64_t window_set_count(const ClientRecord& owner) noexcept {
  std::uint64_t window_sets = 0;
  for (std::uint64_t w = 0; w < owner.window_count; ++w) window_sets += owner.window[w].first == w;
  return window_sets;
}

bool in_the_way(const std::vector<Obstacles::Claim>& claims, std::uint64_t base,
                std::uint64_t bytes) noexcept {
  return std::any_of(claims.begin(), claims.end(), [&](const Obstacles::Claim& claim) {
    return claim.counts && claim.base < base + bytes && base < claim.base + claim.bytes;
  });
}

/// Returns how much must remain when a heap moves for a process of this user.
std::uint64_t reserve_for(const ClientRecord& owner, std::uint32_t reader_uid) noexcept {
  return owner.uid != reader_uid ? 1 : 0;
}

bool may_move(const ClientRecord& owner, std::uint64_t reserve) noexcept {
  return window_set_count(owner) + reserve <= abi::heap_move_max;
}

}  // namespace

/// Visits the active publishers or subscriptions of a process, each with its active matches:
/// function(publisher, subscription).
template <class Function>
void AddressConflicts::for_each_match(ClientIndex client, Kind kind, Function function) const {
  const auto visit = [&](TopicIndex topic, std::uint32_t p, std::uint32_t s) {
    const PublisherRecord& publisher = registry_.publisher(topic, p);
    const SubscriptionRecord& subscription = registry_.subscription(topic, s);
    if (publisher.state == EndpointState::active && subscription.state == EndpointState::active &&
        matches(publisher, subscription))
      function(EndpointRef{Kind::publisher, topic, p}, EndpointRef{Kind::subscription, topic, s});
  };
  for (const EndpointRef& own : registry_.endpoints_of(client)) {
    if (own.kind != kind) continue;
    if (kind == Kind::publisher) {
      registry_.for_each_subscription(own.topic, [&](std::uint32_t s, const SubscriptionRecord&) {
        visit(own.topic, own.index, s);
      });
    } else {
      registry_.for_each_publisher(own.topic, [&](std::uint32_t p, const PublisherRecord&) {
        visit(own.topic, p, own.index);
      });
    }
  }
}

Result<void> AddressConflicts::add_obstacle(const PeerIdentity& identity, ClientIndex client,
                                            const wire::Blocked& range) {
  std::string_view text;
  AGNOCAST_CHECK(text_of(range.what, text));
  const std::string what = printable(text);
  MemoryReserve::no_return();
  const std::size_t before = obstacles_.of(client).size();
  if (auto added = obstacles_.add(client, identity.uid, range.base, range.bytes, what); !added)
    return added;
  // A repeated report: its publishers know it, and further notices would go to others.
  if (obstacles_.of(client).size() == before) return {};
  log_for_user(log_, LogLevel::info, identity.uid, "addresses blocked",
               {{"pid", identity.pid},
                {"uid", identity.uid},
                {"base", hexadecimal(range.base)},
                {"bytes", range.bytes},
                {"what", what}});
  look_at_subscriptions_of(client);  // a client that comes back to a new daemon has some
  return {};
}

/// Chooses a window that the process can map, and that as few others as possible cannot.
Result<WindowRecord> AddressConflicts::choose_window(ClientIndex client) {
  const ClientRecord& record = registry_.client(client);
  const std::uint64_t bytes = arena_.window_bytes;
  const auto choice = plan_.take(obstacles_.against(client));
  if (!choice && plan_.best())
    return fail_with(Errc::arena_occupied, "no window is left that this process can map; it has " +
                                               obstacles_.of(client).front().what);
  if (!choice)
    return fail_with(Errc::limit_reached,
                     "[heap] arena_bytes has room for " + std::to_string(plan_.window_count()) +
                         " windows of " + std::to_string(bytes) + " bytes, all are in use");
  if (choice->weight != 0)
    log_for_user(
        log_, LogLevel::warning, record.uid, "no window is free in all processes",
        {{"pid", record.pid}, {"base", hexadecimal(choice->base)}, {"blocked_in", choice->weight}});
  const std::uint64_t window = record.window_count;
  const bool begins = window == 0 || should_move(client);
  return WindowRecord{choice->base, bytes, begins ? window : record.window[window - 1].first};
}

std::optional<AddressConflicts::Collision> AddressConflicts::collision(ClientIndex owner,
                                                                       ClientIndex reader) const {
  const ClientRecord& record = registry_.client(owner);
  if (owner == reader || record.window_count == 0) return std::nullopt;
  for (std::uint64_t w = record.window[record.window_count - 1].first; w < record.window_count;
       ++w) {
    if (const auto* claim = obstacles_.in_the_way(reader, record.window[w]))
      return Collision{w, claim};
  }
  return std::nullopt;
}

/// Returns whether a reader of this process blocks a window that the process allocates from.
bool AddressConflicts::should_move(ClientIndex owner) const {
  const ClientRecord& record = registry_.client(owner);
  if (!may_move(record, 0)) return false;
  bool should = false;
  for_each_match(owner, Kind::publisher, [&](const EndpointRef&, const EndpointRef& subscription) {
    const ClientIndex reader = registry_.owner_of(subscription);
    const auto found = collision(owner, reader);
    should = should || (found && found->claim->counts &&
                        may_move(record, reserve_for(record, registry_.client(reader).uid)));
  });
  return should;
}

/// Searched once a request: it walks all matches of the owner, and there may be as many notices.
const std::string& AddressConflicts::why_not_moved(ClientIndex owner, ClientIndex reader) {
  const auto [known, is_new] =
      why_not_moved_.try_emplace({number(owner), number(reader)}, std::string());
  if (is_new) known->second = find_why_not_moved(owner, reader);
  return known->second;
}

std::string AddressConflicts::find_why_not_moved(ClientIndex owner, ClientIndex reader) const {
  const ClientRecord& record = registry_.client(owner);
  const std::uint64_t bytes = arena_.window_bytes;
  const std::uint64_t reserve = reserve_for(record, registry_.client(reader).uid);
  const std::string what_remains =
      reserve != 0 ? "; the last one is reserved for its own user" : "";
  if (!may_move(record, reserve))
    return "it has moved " + std::to_string(window_set_count(record) - 1) + " times" + what_remains;
  if (record.window_count + reserve >= heap_.windows_per_process)
    return "[heap] windows_per_process is " + std::to_string(heap_.windows_per_process) +
           what_remains;
  const std::uint64_t used = registry_.accounts().usage_of(record.uid).heap_bytes;
  const std::uint64_t quota = admission_.heap_quota();
  if (used > quota || bytes * (1 + reserve) > quota - used)
    return "[quota] heap_bytes is used up" + what_remains;
  const auto choice = plan_.best(obstacles_.against(owner));
  bool helps = choice.has_value();
  for_each_match(owner, Kind::publisher, [&](const EndpointRef&, const EndpointRef& subscription) {
    helps =
        helps && !in_the_way(obstacles_.of(registry_.owner_of(subscription)), choice->base, bytes);
  });
  return helps ? "" : "there is no free window that all its readers can map";
}

void AddressConflicts::look_at(const EndpointRef& publisher, const EndpointRef& subscription) {
  const ClientIndex owner = registry_.owner_of(publisher);
  const ClientIndex reader = registry_.owner_of(subscription);
  const auto found = collision(owner, reader);
  if (!found) return;
  const ClientRecord& record = registry_.client(owner);
  const std::string why_not =
      !found->claim->counts ? "the reader's user blocks too much" : why_not_moved(owner, reader);
  const auto is_news = [&](const EndpointRef& own, const EndpointRef& its) {
    Session* const session = channel_.session_of(registry_.owner_of(own));
    return session != nullptr &&
           session->collisions().report({own.kind, number(own.topic), own.index},
                                        {its.kind, number(its.topic), its.index},
                                        {registry_.generation_of(own), registry_.generation_of(its),
                                         found->window, why_not.empty()});
  };
  const bool tells_publisher = is_news(publisher, subscription);
  const bool tells_subscription = is_news(subscription, publisher);
  if (!tells_publisher && !tells_subscription) return;
  const std::string outcome =
      why_not.empty() ? "it goes on in another window" : "it stays: " + why_not;
  const ClientRecord& other = registry_.client(reader);
  const std::string text =
      "process " + std::to_string(other.pid) + " (user " + std::to_string(other.uid) +
      ") cannot map heap window " + std::to_string(found->window) + " of process " +
      std::to_string(record.pid) + "; " + outcome + "; it has another mapping at " +
      hexadecimal(found->claim->base) + ", " + std::to_string(found->claim->bytes) + " bytes";
  const std::string whole = text + ": " + found->claim->what;
  // Names of files that a process has mapped are not shown to other users.
  const bool same_user = record.uid == other.uid;
  if (tells_publisher)
    endpoint_manager_.notice(publisher, Errc::arena_occupied, same_user ? whole : text);
  if (tells_subscription) endpoint_manager_.notice(subscription, Errc::arena_occupied, whole);
  log_for_user(log_, LogLevel::warning, other.uid, "heap collides",
               {{"topic", registry_.topic(publisher.topic).name},
                {"publisher_pid", record.pid},
                {"subscriber_pid", other.pid},
                {"window", found->window},
                {"base", hexadecimal(record.window[found->window].base)},
                {"outcome", outcome},
                {"what", found->claim->what}});
  if (!why_not.empty() || !tells_publisher) return;
  auto packet = make_body<wire::MoveHeap>(wire::Opcode::move_heap);
  packet.window = record.window_count;
  channel_.send(owner, packet_of(packet), {});
}

void AddressConflicts::look_at_publishers_of(ClientIndex owner) {
  why_not_moved_.clear();
  for_each_match(owner, Kind::publisher,
                 [&](const EndpointRef& publisher, const EndpointRef& subscription) {
                   look_at(publisher, subscription);
                 });
}

void AddressConflicts::look_at_subscriptions_of(ClientIndex reader) {
  why_not_moved_.clear();
  for_each_match(reader, Kind::subscription,
                 [&](const EndpointRef& publisher, const EndpointRef& subscription) {
                   look_at(publisher, subscription);
                 });
}

}  // namespace agnocast::daemon
