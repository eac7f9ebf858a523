// SPDX-License-Identifier: Apache-2.0
//
// Membership, how things end: what the end of an endpoint means to others, and when its place, its topic
// and its process may be used again (rule RU). Called by those who leave, by the reaper, and once by a
// daemon that goes on.

#include <daemon/lifecycle/membership_parts.hpp>
#include <daemon/state/steps.hpp>

#include <algorithm>
#include <functional>
#include <iterator>
#include <limits>

namespace agnocast::daemon {
namespace {

bool is_over(EndpointState subscription) noexcept {
  return subscription == EndpointState::over || subscription == EndpointState::dead;
}

}  // namespace

// --- what happens to others

void Membership::orphan(const EndpointRef& ref, std::uint64_t final_head,
                        journal::LeaveCause cause) {
  registry_.orphan_publisher(ref.topic, ref.index, final_head, cause);
  registry_.for_each_subscription(ref.topic, [&](std::uint32_t, const SubscriptionRecord& record) {
    if (record.state != EndpointState::active) return;
    AGNOCAST_CRASH_POINT(B_ring);
    doorbells_.ring(record.client, record.executor);
  });
  for_each_told(registry_.told_of(ref), [&](ClientIndex to) { say_orphaned(ref, to); });
  limit_orphans(ref.topic);
}

void Membership::say_orphaned(const EndpointRef& ref, ClientIndex to) {
  auto packet = make_body<wire::Orphaned>(wire::Opcode::orphaned);
  packet.topic = number(ref.topic);
  packet.index = ref.index;
  packet.generation = registry_.generation_of(ref);
  packet.final_head =
      is_given_up(ref) ? 0 : registry_.final_head_of(ref.topic, ref.index);
  post_.send(to, packet_of(packet), {});
}

// Only asked for: a place is free when everybody has said `unlinked`, as ever. Who neither does nor
// holds anything is found by LetGoWatch.
void Membership::give_up(const EndpointRef& ref) {
  if (!given_up_[user_of(ref)].try_emplace(registry_.generation_of(ref), ref).second) return;
  if (ref.kind == Kind::subscription) return;  // `forget` has asked for it
  for_each_told(registry_.told_of(ref), [&](ClientIndex to) { say_orphaned(ref, to); });
}

std::uint32_t Membership::user_of(const EndpointRef& ref) const {
  return registry_.client(registry_.owner_of(ref)).uid;
}

bool Membership::is_given_up(const EndpointRef& ref) const {
  const auto of_user = given_up_.find(user_of(ref));
  return of_user != given_up_.end() && of_user->second.contains(registry_.generation_of(ref));
}

void Membership::forget_given_up(const EndpointRef& ref) {
  const auto of_user = given_up_.find(user_of(ref));
  if (of_user == given_up_.end()) return;
  of_user->second.erase(registry_.generation_of(ref));
  if (of_user->second.empty()) given_up_.erase(of_user);
}

void Membership::give_up_oldest(std::vector<std::pair<std::uint64_t, EndpointRef>>& over,
                                std::size_t kept) {
  if (over.size() <= kept) return;
  std::sort(over.begin(), over.end(),
            [](const auto& a, const auto& b) { return a.first < b.first; });
  over.resize(over.size() - kept);
  for (const auto& [generation, ref] : over) give_up(ref);
}

void Membership::limit_orphans(TopicIndex topic) {
  std::vector<std::pair<std::uint64_t, EndpointRef>> orphans;
  registry_.for_each_publisher(topic, [&](std::uint32_t i, const PublisherRecord& record) {
    if (record.state == EndpointState::orphan)
      orphans.emplace_back(record.generation, EndpointRef{Kind::publisher, topic, i});
  });
  give_up_oldest(orphans, std::clamp<std::size_t>(registry_.capacity().publishers_per_topic / 2, 1,
                                                  abi::orphan_count_max));
}

void Membership::limit_dead_subscriptions(TopicIndex topic) {
  std::vector<std::pair<std::uint64_t, EndpointRef>> over;
  registry_.for_each_subscription(topic, [&](std::uint32_t i, const SubscriptionRecord& record) {
    if (is_over(record.state))
      over.emplace_back(record.generation, EndpointRef{Kind::subscription, topic, i});
  });
  give_up_oldest(over, std::max<std::size_t>(registry_.capacity().subscriptions_per_topic / 2, 1));
}

// Half of the places, and half of the arena, are for those that live. The user who has most of the rest
// makes room for the others: nobody loses what is unread because of another user's dead.
void Membership::limit_gone() {
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
    // The place of one that was revoked and lives is its own.
    if (record.state == ClientState::free || registry_.is_alive(client) ||
        registry_.is_revoked(client))
      continue;
    Gone& of_user = by_user[record.uid];
    of_user.clients.emplace_back(record.generation, client);
    of_user.window_count += record.window_count;
    ++count;
    window_count += record.window_count;
  }
  if (count <= places && window_count <= windows) return;
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
    give_up_all_of(client);
  }
}

void Membership::give_up_all_of(ClientIndex client) {
  for (const EndpointRef& ref : registry_.endpoints_of(client)) {
    const bool over = ref.kind == Kind::publisher
                          ? registry_.publisher(ref.topic, ref.index).state == EndpointState::orphan
                          : is_over(registry_.subscription(ref.topic, ref.index).state);
    if (over) give_up(ref);
  }
}

// Whoever keeps publishers that are gone is named. It holds messages of them, or LetGoWatch is not done
// with it; anybody may revoke it.
tl::unexpected<Failure> Membership::explain_full(TopicIndex topic, const Failure& why,
                                                 std::optional<std::uint32_t> uid) const {
  std::uint64_t orphans = 0;
  std::vector<std::uint64_t> kept(registry_.client_high(), 0);
  registry_.for_each_publisher(topic, [&](std::uint32_t, const PublisherRecord& record) {
    if (record.state != EndpointState::orphan ||
        (uid && registry_.client(record.client).uid != *uid))
      return;
    ++orphans;
    for_each_told(record.told, [&](ClientIndex by) { ++kept[number(by)]; });
  });
  const auto most = std::max_element(kept.begin(), kept.end());
  const bool is_full = why.code == Errc::limit_reached || why.code == Errc::quota_exceeded;
  if (!is_full || most == kept.end() || *most == 0) return tl::unexpected(why);
  const ClientRecord& process =
      registry_.client(static_cast<ClientIndex>(std::distance(kept.begin(), most)));
  return fail_with(why.code,
                   std::string(detail_of(why)) + "; " + std::to_string(orphans) +
                       " of them are gone, and process " + std::to_string(process.pid) + " (" +
                       printable(process.name) + ") has not let go of " + std::to_string(*most));
}

void Membership::bury_subscription(const EndpointRef& ref) {
  registry_.change_subscription(ref.topic, ref.index, EndpointState::dead);
  forget_subscription(ref);
  kick_publishers_of(ref);
}

void Membership::forget_subscription(const EndpointRef& ref) {
  const auto packet = reference_to(ref, registry_.generation_of(ref), wire::Opcode::forget);
  for_each_told(registry_.told_of(ref),
                [&](ClientIndex to) { post_.send(to, packet_of(packet), {}); });
  limit_dead_subscriptions(ref.topic);
}

void Membership::kick(TopicIndex topic, std::uint32_t publisher) {
  const EndpointRef ref{Kind::publisher, topic, publisher};
  const auto packet = reference_to(ref, registry_.generation_of(ref), wire::Opcode::kick);
  post_.send(registry_.owner_of(ref), packet_of(packet), {});
}

void Membership::kick_publishers_of(const EndpointRef& subscription) {
  const AnnounceSet& told = registry_.told_of(subscription);
  registry_.for_each_publisher(subscription.topic,
                               [&](std::uint32_t i, const PublisherRecord& record) {
                                 if (told.contains(number(record.client)))
                                   kick(subscription.topic, i);
                               });
}

// --- rule RU

void Membership::let_go(const EndpointRef& ref, ClientIndex by) {
  registry_.let_go(ref, by);
  settle(ref);
}

void Membership::settle(const EndpointRef& ref) {
  if (!registry_.is_used(ref) || !registry_.told_of(ref).reusable()) return;
  AGNOCAST_CRASH_POINT(B_settle);
  const ClientIndex owner = registry_.owner_of(ref);
  const bool owner_dead = !registry_.is_alive(owner);
  if (ref.kind == Kind::publisher) {
    const EndpointState state = registry_.publisher(ref.topic, ref.index).state;
    if (state != EndpointState::orphan && state != EndpointState::over) return;
    forget_given_up(ref);
    if (owner_dead) {
      registry_.end_publisher(ref.topic, ref.index, EndpointState::free);
    } else if (state == EndpointState::orphan) {
      // Its process still has messages to destroy in that extent, and says when it is done.
      registry_.end_publisher(ref.topic, ref.index, EndpointState::over);
      kick(ref.topic, ref.index);
      return;
    }
  } else {
    const EndpointState state = registry_.subscription(ref.topic, ref.index).state;
    if (!is_over(state)) return;
    forget_given_up(ref);
    registry_.free_subscription(ref.topic, ref.index);
  }
  settle_topic(ref.topic);
  settle_client(owner);
}

void Membership::settle_topic(TopicIndex topic) {
  if (registry_.topic(topic).state != TopicState::used || !registry_.topic_is_empty(topic)) return;
  registry_.free_topic(topic);
  for (auto& [client, topics] : type_notices_) topics.reset(number(topic));
}

void Membership::settle_client(ClientIndex client) {
  if (!registry_.can_end(client)) return;
  registry_.end_client(client);
  if (on_ended) on_ended(client);
}

void Membership::forget_client(ClientIndex client) {
  registry_.client_forgotten(client);
  missed_notices_.erase(number(client));
  to_tell_.erase(client);
  type_notices_.erase(number(client));
}

// drained() has two halves: its own record, and one for each thing that its process has let go of
// with it. The second half follows from what the tables say then.
void Membership::finish() {
  const auto lets_go = [&](const EndpointRef& ref, const std::set<ClientIndex>& users) {
    std::vector<ClientIndex> gone;
    for_each_told(registry_.told_of(ref), [&](ClientIndex to) {
      if (registry_.is_alive(to) && users.count(to) == 0) gone.push_back(to);
    });
    for (const ClientIndex client : gone) let_go(ref, client);
  };
  for (std::uint32_t t = 0; t < registry_.topic_high(); ++t) {
    const TopicIndex topic{t};
    if (registry_.topic(topic).state != TopicState::used) continue;
    // Places are freed in the middle of this, and the topic goes with its last endpoint.
    registry_.for_each_publisher(topic, [&](std::uint32_t p, const PublisherRecord& publisher) {
      std::set<ClientIndex> users;
      registry_.for_each_subscription(topic, [&](std::uint32_t, const SubscriptionRecord& own) {
        if ((own.state == EndpointState::active || own.state == EndpointState::leaving) &&
            matches(publisher, own))
          users.insert(own.client);
      });
      lets_go({Kind::publisher, topic, p}, users);
    });
    std::set<ClientIndex> publish;
    registry_.for_each_publisher(topic, [&](std::uint32_t, const PublisherRecord& own) {
      publish.insert(own.client);
    });
    registry_.for_each_subscription(topic, [&](std::uint32_t s, const SubscriptionRecord&) {
      lets_go({Kind::subscription, topic, s}, publish);
    });
  }
  settle_all();
  // Who comes back is told at once whom to let go of.
  for (std::uint32_t t = 0; t < registry_.topic_high(); ++t) {
    if (registry_.topic(TopicIndex{t}).state != TopicState::used) continue;
    limit_orphans(TopicIndex{t});
    limit_dead_subscriptions(TopicIndex{t});
  }
  limit_gone();
}

void Membership::settle_all() {
  for (std::uint32_t t = 0; t < registry_.topic_high(); ++t) {
    const TopicIndex topic{t};
    if (registry_.topic(topic).state != TopicState::used) continue;
    registry_.for_each_publisher(topic, [&](std::uint32_t i, const PublisherRecord&) {
      settle({Kind::publisher, topic, i});
    });
    registry_.for_each_subscription(topic, [&](std::uint32_t i, const SubscriptionRecord&) {
      settle({Kind::subscription, topic, i});
    });
    settle_topic(topic);
  }
  settle_clients();
}

void Membership::settle_clients() {
  for (std::uint32_t c = 0; c < registry_.client_high(); ++c)
    settle_client(static_cast<ClientIndex>(c));
}

}  // namespace agnocast::daemon
