// SPDX-License-Identifier: Apache-2.0
//
// Endings: see the header.

#include <daemon/lifecycle/endings.hpp>

#include <daemon/lifecycle/references.hpp>

#include <algorithm>
#include <functional>
#include <iterator>
#include <limits>
#include <set>
#include <string>

namespace agnocast::daemon {
namespace {

bool is_over(EndpointState subscription) noexcept {
  return subscription == EndpointState::over || subscription == EndpointState::dead;
}

}  // namespace

// --- effects on others

Effects Endings::orphan(const EndpointRef& ref, std::uint64_t final_head,
                        journal::LeaveCause cause) const {
  Effects effects{effect::OrphanPublisher{ref, final_head, cause}};
  registry_.for_each_subscription(ref.topic, [&](std::uint32_t, const SubscriptionRecord& record) {
    if (record.state == EndpointState::active)
      effects.push_back(effect::Ring{record.client, record.wait_set});
  });
  const auto packet = orphaned(ref, final_head);
  for_each_notified(registry_, registry_.notified_of(ref), [&](ClientIndex to) {
    effects.push_back(effect::Send{to, packet});
  });
  effects.push_back(effect::GiveUpOrphans{ref.topic});
  return effects;
}

wire::Orphaned Endings::orphaned(const EndpointRef& ref, std::uint64_t final_head) const {
  auto packet = make_body<wire::Orphaned>(wire::Opcode::orphaned);
  packet.topic = number(ref.topic);
  packet.index = ref.index;
  packet.generation = registry_.generation_of(ref);
  packet.final_head = final_head;
  return packet;
}

wire::Orphaned Endings::orphaned(const EndpointRef& ref) const {
  return orphaned(ref, is_given_up(ref) ? 0 : registry_.final_head_of(ref.topic, ref.index));
}

Effects Endings::close_subscription(const EndpointRef& ref) const {
  Effects effects{effect::ChangeSubscription{ref, EndpointState::dead}};
  append(effects, ask_to_unmap(ref));
  append(effects, kick_publishers_of(ref));
  return effects;
}

Effects Endings::ask_to_unmap(const EndpointRef& subscription) const {
  Effects effects;
  const auto packet =
      reference_to(subscription, registry_.generation_of(subscription), wire::Opcode::forget);
  for_each_notified(registry_, registry_.notified_of(subscription), [&](ClientIndex to) {
    effects.push_back(effect::Send{to, packet});
  });
  effects.push_back(effect::GiveUpSubscriptions{subscription.topic});
  return effects;
}

effect::Send Endings::kick(const EndpointRef& publisher) const {
  return {registry_.owner_of(publisher),
          reference_to(publisher, registry_.generation_of(publisher), wire::Opcode::kick)};
}

Effects Endings::kick_publishers_of(const EndpointRef& subscription) const {
  Effects effects;
  const AnnounceSet& notified = registry_.notified_of(subscription);
  registry_.for_each_publisher(
      subscription.topic, [&](std::uint32_t i, const PublisherRecord& record) {
        if (notified.contains(number(record.client)))
          effects.push_back(kick({Kind::publisher, subscription.topic, i}));
      });
  return effects;
}

// --- too many that are over

// Only asks: the place is free, as always, when all processes have sent `unlinked`. UnmapWatch
// finds a process that neither does so nor holds anything.
Effects Endings::give_up(const EndpointRef& ref) {
  Effects effects;
  if (!given_up_[user_of(ref)].try_emplace(registry_.generation_of(ref), ref).second)
    return effects;
  if (ref.kind == Kind::subscription) return effects;  // ask_to_unmap() has asked
  const auto packet = orphaned(ref);
  for_each_notified(registry_, registry_.notified_of(ref), [&](ClientIndex to) {
    effects.push_back(effect::Send{to, packet});
  });
  return effects;
}

std::uint32_t Endings::user_of(const EndpointRef& ref) const {
  return registry_.client(registry_.owner_of(ref)).uid;
}

bool Endings::is_given_up(const EndpointRef& ref) const {
  const auto of_user = given_up_.find(user_of(ref));
  return of_user != given_up_.end() && of_user->second.contains(registry_.generation_of(ref));
}

void Endings::forget_given_up(const EndpointRef& ref) {
  const auto of_user = given_up_.find(user_of(ref));
  if (of_user == given_up_.end()) return;
  of_user->second.erase(registry_.generation_of(ref));
  if (of_user->second.empty()) given_up_.erase(of_user);
}

Effects Endings::give_up_oldest(Aged& over, std::size_t kept) {
  Effects effects;
  if (over.size() <= kept) return effects;
  std::sort(over.begin(), over.end(),
            [](const auto& a, const auto& b) { return a.first < b.first; });
  over.resize(over.size() - kept);
  for (const auto& [generation, ref] : over) append(effects, give_up(ref));
  return effects;
}

Effects Endings::give_up_orphans(TopicIndex topic) {
  Aged orphans;
  registry_.for_each_publisher(topic, [&](std::uint32_t i, const PublisherRecord& record) {
    if (record.state == EndpointState::orphan)
      orphans.emplace_back(record.generation, EndpointRef{Kind::publisher, topic, i});
  });
  return give_up_oldest(orphans,
                        std::clamp<std::size_t>(registry_.capacity().publishers_per_topic / 2, 1,
                                                abi::orphan_count_max));
}

Effects Endings::give_up_subscriptions(TopicIndex topic) {
  Aged over;
  registry_.for_each_subscription(topic, [&](std::uint32_t i, const SubscriptionRecord& record) {
    if (is_over(record.state))
      over.emplace_back(record.generation, EndpointRef{Kind::subscription, topic, i});
  });
  return give_up_oldest(over,
                        std::max<std::size_t>(registry_.capacity().subscriptions_per_topic / 2, 1));
}

Effects Endings::give_up_all_of(ClientIndex client) {
  Effects effects;
  for (const EndpointRef& ref : registry_.endpoints_of(client)) {
    const EndpointState state = state_of(registry_, ref);
    if (ref.kind == Kind::publisher ? state == EndpointState::orphan : is_over(state))
      append(effects, give_up(ref));
  }
  return effects;
}

// Living processes keep half of the places and half of the arena. The user with most of the rest
// makes room for the others: no user loses unread messages to another user's dead.
Effects Endings::give_up_gone() {
  struct Gone {
    std::vector<std::pair<std::uint64_t, ClientIndex>> clients;  // by generation
    std::uint64_t window_count = 0;
  };
  const TableHeader& header = registry_.header();
  const std::uint64_t places = registry_.capacity().clients / 2;
  std::uint64_t windows = std::numeric_limits<std::uint64_t>::max();
  if (header.window_bytes > 0)
    windows = std::max<std::uint64_t>(header.arena_bytes / header.window_bytes / 2, 1);
  std::map<std::uint32_t, Gone> by_user;
  std::uint64_t count = 0, window_count = 0;
  for (std::uint32_t i = 0; i < registry_.client_high(); ++i) {
    const ClientIndex client{i};
    const ClientRecord& record = registry_.client(client);
    // A revoked process that lives keeps its place.
    if (record.state == ClientState::free || registry_.is_alive(client) ||
        registry_.is_revoked(client))
      continue;
    Gone& of_user = by_user[record.uid];
    of_user.clients.emplace_back(record.generation, client);
    of_user.window_count += record.window_count;
    ++count;
    window_count += record.window_count;
  }
  Effects effects;
  if (count <= places && window_count <= windows) return effects;
  for (auto& [uid, of_user] : by_user)  // the oldest last
    std::sort(of_user.clients.begin(), of_user.clients.end(), std::greater<>());
  while (count > places || window_count > windows) {
    const auto most = std::max_element(
        by_user.begin(), by_user.end(), [by_places = count > places](const auto& a, const auto& b) {
          return by_places ? a.second.clients.size() < b.second.clients.size()
                           : a.second.window_count < b.second.window_count;
        });
    Gone& of_user = most->second;
    const ClientIndex client = of_user.clients.back().second;
    of_user.clients.pop_back();
    const std::uint64_t had = registry_.client(client).window_count;
    --count;
    window_count -= had;
    of_user.window_count -= had;
    append(effects, give_up_all_of(client));
  }
  return effects;
}

// Names the process that keeps gone publishers. It holds messages of them, or UnmapWatch still
// waits for it; its user or root may revoke it.
tl::unexpected<Failure> Endings::explain_full(TopicIndex topic, const Failure& why,
                                              std::optional<std::uint32_t> uid) const {
  std::uint64_t orphans = 0;
  std::vector<std::uint64_t> kept(registry_.client_high(), 0);
  registry_.for_each_publisher(topic, [&](std::uint32_t, const PublisherRecord& record) {
    if (record.state != EndpointState::orphan ||
        (uid && registry_.client(record.client).uid != *uid))
      return;
    ++orphans;
    for_each_notified(registry_, record.notified, [&](ClientIndex by) { ++kept[number(by)]; });
  });
  const auto most = std::max_element(kept.begin(), kept.end());
  const bool is_full = why.code == Errc::limit_reached || why.code == Errc::quota_exceeded;
  if (!is_full || most == kept.end() || *most == 0) return tl::unexpected(why);
  const ClientRecord& process =
      registry_.client(static_cast<ClientIndex>(std::distance(kept.begin(), most)));
  return fail_with(why.code, std::string(detail_of(why)) + "; " + std::to_string(orphans) +
                                 " of them are gone, and process " + std::to_string(process.pid) +
                                 " (" + printable(process.name) + ") has not unmapped " +
                                 std::to_string(*most));
}

// --- rule RU

Effects Endings::acknowledge(const EndpointRef& ref, ClientIndex by) const {
  return {effect::Acknowledge{ref, by}, effect::FreeUnused{ref}};
}

Effects Endings::free_unused(const EndpointRef& ref) {
  Effects effects;
  if (!registry_.is_used(ref) || !registry_.notified_of(ref).reusable()) return effects;
  effects.push_back(effect::BeginFree{});
  const EndpointState state = state_of(registry_, ref);
  const ClientIndex owner = registry_.owner_of(ref);
  if (ref.kind == Kind::publisher) {
    if (state != EndpointState::orphan && state != EndpointState::over) return effects;
    forget_given_up(ref);
    if (!registry_.is_alive(owner)) {
      effects.push_back(effect::EndPublisher{ref, EndpointState::free});
    } else if (state == EndpointState::orphan) {
      // Its process still has messages to destroy in that extent, and reports when it is done.
      effects.push_back(effect::EndPublisher{ref, EndpointState::over});
      effects.push_back(kick(ref));
      return effects;
    }
  } else {
    if (!is_over(state)) return effects;
    forget_given_up(ref);
    effects.push_back(effect::FreeSubscription{ref});
  }
  effects.push_back(effect::FreeUnusedTopic{ref.topic});
  effects.push_back(effect::FreeUnusedClient{owner});
  return effects;
}

Effects Endings::free_unused_topic(TopicIndex topic) const {
  if (registry_.topic(topic).state != TopicState::used || !registry_.topic_is_empty(topic))
    return {};
  return {effect::FreeTopic{topic}};
}

Effects Endings::free_unused_client(ClientIndex client) const {
  if (!registry_.can_free(client)) return {};
  return {effect::FreeClient{client}};
}

Effects Endings::free_unused_clients() const {
  Effects effects;
  for (std::uint32_t c = 0; c < registry_.client_high(); ++c)
    append(effects, free_unused_client(static_cast<ClientIndex>(c)));
  return effects;
}

// --- for a daemon that continues

Effects Endings::owed_acknowledgements(Kind kind, TopicIndex topic) const {
  Effects effects;
  const auto owed = [&](const EndpointRef& ref, const std::set<ClientIndex>& users) {
    for_each_notified(registry_, registry_.notified_of(ref), [&](ClientIndex to) {
      if (registry_.is_alive(to) && users.count(to) == 0) append(effects, acknowledge(ref, to));
    });
  };
  if (kind == Kind::publisher) {
    registry_.for_each_publisher(topic, [&](std::uint32_t p, const PublisherRecord& publisher) {
      std::set<ClientIndex> users;
      registry_.for_each_subscription(topic, [&](std::uint32_t, const SubscriptionRecord& own) {
        if ((own.state == EndpointState::active || own.state == EndpointState::leaving) &&
            matches(publisher, own))
          users.insert(own.client);
      });
      owed({Kind::publisher, topic, p}, users);
    });
    return effects;
  }
  std::set<ClientIndex> publish;
  registry_.for_each_publisher(
      topic, [&](std::uint32_t, const PublisherRecord& own) { publish.insert(own.client); });
  registry_.for_each_subscription(topic, [&](std::uint32_t s, const SubscriptionRecord&) {
    owed({Kind::subscription, topic, s}, publish);
  });
  return effects;
}

Effects Endings::free_all_unused(TopicIndex topic) const {
  Effects effects;
  registry_.for_each_publisher(topic, [&](std::uint32_t i, const PublisherRecord&) {
    effects.push_back(effect::FreeUnused{{Kind::publisher, topic, i}});
  });
  registry_.for_each_subscription(topic, [&](std::uint32_t i, const SubscriptionRecord&) {
    effects.push_back(effect::FreeUnused{{Kind::subscription, topic, i}});
  });
  effects.push_back(effect::FreeUnusedTopic{topic});
  return effects;
}

}  // namespace agnocast::daemon
