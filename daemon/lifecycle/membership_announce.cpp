// SPDX-License-Identifier: Apache-2.0
//
// Membership, what others are told: announcements, all of them once more on a new connection, and
// notices. Whoever is told of something is entered into its announce set first (tell()).

#include <base/check.hpp>
#include <daemon/lifecycle/membership.hpp>
#include <daemon/lifecycle/references.hpp>
#include <daemon/state/memory_reserve.hpp>

#include <algorithm>
#include <cstddef>
#include <cstring>

namespace agnocast::daemon {
namespace {

/// What both kinds of endpoint have; not yet whom it is for.
template <class Record>
wire::Announcement announcement_of(const EndpointRef& ref, const Record& record,
                                   const Registry& registry) {
  auto packet = make_body<wire::Announcement>(wire::Opcode::announce);
  packet.kind = ref.kind;
  packet.topic = number(ref.topic);
  packet.index = ref.index;
  packet.generation = record.generation;
  packet.client = number(record.client);
  packet.client_generation = registry.client(record.client).generation;
  packet.extent = record.extent;
  packet.qos = record.qos;
  packet.uid = registry.client(record.client).uid;
  return packet;
}

}  // namespace

// --- announcements

// Whoever is told has to let go before the place is used again. No session: it has no connection,
// and is announced this when it is back.
Session* Membership::tell(const EndpointRef& ref, ClientIndex to) {
  if (!registry_.is_alive(to) || regions_.region_reader(registry_.owner_of(ref)) == nullptr)
    return nullptr;
  registry_.tell(ref, to);
  return post_.session_of(to);
}

void Membership::announce_publisher(TopicIndex topic, std::uint32_t index,
                                    std::uint32_t subscription) {
  const PublisherRecord& publisher = registry_.publisher(topic, index);
  const SubscriptionRecord& member = registry_.subscription(topic, subscription);
  if (tell({Kind::publisher, topic, index}, member.client) == nullptr) return;
  auto packet = announcement_of({Kind::publisher, topic, index}, publisher, registry_);
  packet.own_index = subscription;
  packet.own_generation = member.generation;
  packet.first_sequence = abi::first_sequence_of(publisher.generation);
  packet.quota = registry_.hold_quota(member, publisher);
  // One counter for all generations: the publisher joined later.
  packet.from_start = publisher.generation > member.generation ? 1 : 0;
  packet.same_user = are_of_one_user(publisher.client, member.client) ? 1 : 0;
  std::vector<SharedFd> fds{regions_.region_reader(publisher.client)};
  const ClientRecord& owner = registry_.client(publisher.client);
  for (const SharedFd& reader : regions_.window_readers(publisher.client)) {
    const WindowRecord& window = owner.window[packet.window_count];
    packet.window[packet.window_count++] = {window.base, window.bytes, window.first};
    fds.push_back(reader);
  }
  const auto bytes = packet_of(packet);
  announce({Kind::publisher, topic, index}, member.client,
           {{bytes.begin(), bytes.end()}, std::move(fds), {}});
  if (on_matched)
    on_matched({Kind::publisher, topic, index}, {Kind::subscription, topic, subscription});
}

// One uid in two user namespaces is two users.
bool Membership::are_of_one_user(ClientIndex one, ClientIndex other) const {
  const std::uint64_t user_namespace = post_.user_namespace_of(one);
  return registry_.client(one).uid == registry_.client(other).uid && user_namespace != 0 &&
         user_namespace == post_.user_namespace_of(other);
}

void Membership::announce_subscription(TopicIndex topic, std::uint32_t index,
                                       std::uint32_t publisher) {
  const SubscriptionRecord& subscription = registry_.subscription(topic, index);
  const PublisherRecord& member = registry_.publisher(topic, publisher);
  if (tell({Kind::subscription, topic, index}, member.client) == nullptr) return;
  auto packet = announcement_of({Kind::subscription, topic, index}, subscription, registry_);
  packet.own_index = publisher;
  packet.own_generation = member.generation;
  packet.executor = subscription.executor;
  packet.quota = registry_.hold_quota(subscription, member);
  const bool same_user = are_of_one_user(subscription.client, member.client);
  packet.same_user = same_user ? 1 : 0;
  const auto bytes = packet_of(packet);
  announce({Kind::subscription, topic, index}, member.client,
           {{bytes.begin(), bytes.end()},
            {regions_.region_reader(subscription.client)},
            [=, this, generation = subscription.generation](Outgoing& out) {
              add_doorbells(out, {Kind::subscription, topic, index}, generation, same_user);
            }});
}

// It may be over by now: whoever has drained its last publisher there has let go of what it never read
// about. Then its place may be another's, of another user perhaps, and that one's bells are not for it.
void Membership::add_doorbells(Outgoing& packet, const EndpointRef& ref, std::uint64_t generation,
                               bool same_user) {
  if (!registry_.is_used(ref)) return;
  const SubscriptionRecord& subscription = registry_.subscription(ref.topic, ref.index);
  if (subscription.generation != generation ||
      (subscription.state != EndpointState::active && subscription.state != EndpointState::leaving))
    return;
  const auto bells =
      doorbells_.for_publisher(subscription.client, subscription.executor, same_user);
  if (!bells) {
    waiting_.emplace(generation, ref);
    return;
  }
  packet.fds.insert(packet.fds.end(), bells->begin(), bells->end());
  const auto count = static_cast<std::uint32_t>(bells->size());
  std::memcpy(packet.bytes.data() + offsetof(wire::Announcement, doorbell_count), &count,
              sizeof count);
}

void Membership::renewed(ClientIndex client, std::uint64_t executor) {
  for (const EndpointRef& ref : registry_.endpoints_of(client)) {
    if (ref.kind == Kind::subscription &&
        registry_.subscription(ref.topic, ref.index).executor == executor)
      renewed_.emplace(registry_.generation_of(ref), ref);
  }
}

void Membership::announce_renewed() {
  // Some 10 µs each, with the socket that is made for it.
  constexpr unsigned announcements_max = 200;
  for (unsigned made = 0; !renewed_.empty() && made < announcements_max;) {
    const auto generation = renewed_.begin()->first;
    const EndpointRef ref = renewed_.begin()->second;
    renewed_.erase(renewed_.begin());
    if (!registry_.is_used(ref) || registry_.generation_of(ref) != generation) continue;
    const SubscriptionRecord& subscription = registry_.subscription(ref.topic, ref.index);
    registry_.for_each_publisher(ref.topic, [&](std::uint32_t p, const PublisherRecord& publisher) {
      if (!is_to_know(publisher, subscription)) return;
      announce_subscription(ref.topic, ref.index, p);
      ++made;
    });
  }
}

void Membership::announce(const EndpointRef& ref, ClientIndex to, Outgoing packet) {
  Session* const session = post_.session_of(to);
  AGNOCAST_CHECK(session != nullptr);
  // The number of the packet that is about to be handed in.
  session->announcements().announced(subject_of(ref), session->packet_count() + 1);
  session->announcements().announced(region_of(registry_.owner_of(ref)),
                                     session->packet_count() + 1);
  post_.send(to, std::move(packet));
}

void Membership::announce_window(ClientIndex owner) {
  const ClientRecord& record = registry_.client(owner);
  auto packet = make_body<wire::WindowAnnounced>(wire::Opcode::window_announced);
  packet.client = number(owner);
  packet.client_generation = record.generation;
  packet.window = record.window_count - 1;
  packet.base = record.window[packet.window].base;
  packet.bytes = record.window[packet.window].bytes;
  packet.first = record.window[packet.window].first;
  const SharedFd reader = regions_.window_readers(owner).back();
  // Who has the region because it publishes to this process, reads nothing in its heap.
  const auto reads = [&](ClientIndex to) {
    const auto& endpoints = registry_.endpoints_of(owner);
    return std::any_of(endpoints.begin(), endpoints.end(), [&](const EndpointRef& ref) {
      return ref.kind == Kind::publisher && registry_.told_of(ref).contains(number(to));
    });
  };
  for_each_told(registry_, record.told, [&](ClientIndex to) {
    Session* const session = post_.session_of(to);
    if (session == nullptr || !reads(to)) return;
    session->announcements().announced(region_of(owner), session->packet_count() + 1);
    post_.send(to, packet_of(packet), {reader});
  });
}

// --- after a new connection

// An endpoint's own process is told whom it is connected with: what is there now, and what it was
// told of and has not let go of yet, be it gone or not. Repetitions are the client's to recognise.
void Membership::announce_to_owner(const EndpointRef& ref) {
  if (ref.kind == Kind::subscription) {
    const SubscriptionRecord& own = registry_.subscription(ref.topic, ref.index);
    if (own.state != EndpointState::active && own.state != EndpointState::leaving) return;
    const std::uint64_t owner = number(own.client);
    registry_.for_each_publisher(ref.topic, [&](std::uint32_t p, const PublisherRecord& other) {
      if (!matches(other, own)) return;
      // Nobody joins an orphan.
      const bool drains =
          other.state == EndpointState::orphan && own.generation <= other.last_joined;
      const bool known =
          other.told.contains(owner) && (other.state == EndpointState::active || drains);
      const bool meets = other.state == EndpointState::active && own.state == EndpointState::active;
      if (known || meets) announce_publisher(ref.topic, p, ref.index);
    });
  } else {
    const PublisherRecord& own = registry_.publisher(ref.topic, ref.index);
    registry_.for_each_subscription(ref.topic,
                                    [&](std::uint32_t s, const SubscriptionRecord& other) {
                                      if (is_to_know(own, other))
                                        announce_subscription(ref.topic, s, ref.index);
                                    });
  }
}

bool Membership::is_to_know(const PublisherRecord& own, const SubscriptionRecord& other) const {
  if (!matches(own, other)) return false;
  const bool is_active = own.state == EndpointState::active;
  if (is_active && other.state == EndpointState::active) return true;
  return (is_active || own.state == EndpointState::orphan) &&
         (other.state == EndpointState::active || other.state == EndpointState::leaving) &&
         other.told.contains(number(own.client));
}

bool Membership::is_looked_at(TopicIndex topic, const SubscriptionRecord& subscription,
                              ClientIndex by) const {
  if (subscription.state != EndpointState::active && subscription.state != EndpointState::leaving)
    return false;
  bool looks = false;
  registry_.for_each_publisher(topic, [&](std::uint32_t, const PublisherRecord& record) {
    looks = looks || (record.client == by && record.state != EndpointState::over &&
                      matches(record, subscription));
  });
  return looks;
}

void Membership::say_own(const EndpointRef& ref) {
  auto packet = make_body<wire::Own>(wire::Opcode::own);
  packet.kind = ref.kind;
  packet.topic = number(ref.topic);
  packet.index = ref.index;
  packet.generation = registry_.generation_of(ref);
  if (ref.kind == Kind::publisher) {
    const PublisherRecord& record = registry_.publisher(ref.topic, ref.index);
    packet.creation = record.creation;
    packet.active = record.state == EndpointState::active ? 1 : 0;
  } else {
    const SubscriptionRecord& record = registry_.subscription(ref.topic, ref.index);
    packet.creation = record.creation;
    packet.active = record.state == EndpointState::active ? 1 : 0;
  }
  post_.send(registry_.owner_of(ref), packet_of(packet), {});
}

void Membership::welcome_back(ClientIndex client) {
  ToTell rest;
  // Nothing is told of a topic in which a process has no endpoint, and with the last one it has let
  // go of everything there.
  for (const EndpointRef& ref : registry_.endpoints_of(client)) {
    rest.own.emplace(registry_.generation_of(ref), ref);
    rest.topics.insert(ref.topic);
  }
  rest.endpoints = rest.own;
  tell_more(client, std::move(rest));
}

void Membership::go_on_telling() {
  for (auto& [client, rest] : std::exchange(to_tell_, {})) {
    if (MemoryReserve::refill()) {
      tell_more(client, std::move(rest));
    } else {
      to_tell_.insert_or_assign(client, std::move(rest));
    }
  }
}

// Without a connection it begins anew when it is back.
void Membership::tell_more(ClientIndex client, ToTell rest) {
  while (rest.next_region < registry_.client_high()) {
    Session* const session = post_.session_of(client);
    if (session == nullptr) return;
    const bool is_full = session->queued_count() >= Session::queue_count_max / 2;
    if (is_full || (session->is_crowded() && session->has_output())) {
      to_tell_.insert_or_assign(client, std::move(rest));
      return;
    }
    tell_next(client, rest);
  }
  const auto missed = missed_notices_.extract(number(client));
  if (missed.empty()) return;
  for (const wire::Notice& packet : missed.mapped()) post_.send(client, packet_of(packet), {});
}

void Membership::tell_next(ClientIndex client, ToTell& rest) {
  const auto is_there = [this](std::uint64_t generation, const EndpointRef& ref) {
    return registry_.is_used(ref) && registry_.generation_of(ref) == generation;
  };
  if (!rest.own.empty()) {
    const auto node = rest.own.extract(rest.own.begin());
    if (is_there(node.key(), node.mapped())) say_own(node.mapped());
  } else if (!rest.endpoints.empty()) {
    const auto node = rest.endpoints.extract(rest.endpoints.begin());
    if (is_there(node.key(), node.mapped())) announce_to_owner(node.mapped());
  } else if (!rest.topics.empty()) {
    tell_what_is_over(client, rest.topics.extract(rest.topics.begin()).value());
  } else {
    tell_region(client, rest.next_region++);
  }
}

void Membership::tell_what_is_over(ClientIndex client, TopicIndex topic) {
  registry_.for_each_publisher(topic, [&](std::uint32_t i, const PublisherRecord& record) {
    if (record.state == EndpointState::orphan && record.told.contains(number(client)))
      post_.send(client, packet_of(endings_.orphaned({Kind::publisher, topic, i})), {});
  });
  registry_.for_each_subscription(topic, [&](std::uint32_t i, const SubscriptionRecord& record) {
    if (record.told.contains(number(client)) && !is_looked_at(topic, record, client))
      post_.send(client,
                 packet_of(reference_to({Kind::subscription, topic, i}, record.generation,
                                        wire::Opcode::forget)),
                 {});
  });
}

void Membership::tell_region(ClientIndex client, std::uint32_t owner) {
  const ClientRecord& record = registry_.client(static_cast<ClientIndex>(owner));
  if (record.state == ClientState::free || !record.told.contains(number(client))) return;
  auto packet = make_body<wire::Reference>(wire::Opcode::region);
  packet.kind = Kind::region;
  packet.index = owner;
  packet.generation = record.generation;
  // What the client says of the region before it has read all of this is said too early.
  Session* const session = post_.session_of(client);
  AGNOCAST_CHECK(session != nullptr);
  session->announcements().announced(region_of(static_cast<ClientIndex>(owner)),
                                     session->packet_count() + 1);
  post_.send(client, packet_of(packet), {});
}

// --- notices

void Membership::notice(const EndpointRef& ref, Errc code, const std::string& text,
                        abi::QosPolicy policy) {
  auto packet = make_body<wire::Notice>(wire::Opcode::notice);
  packet.code = static_cast<std::uint32_t>(code);
  packet.policy = policy;
  packet.kind = ref.kind;
  packet.topic = number(ref.topic);
  packet.index = ref.index;
  packet.generation = registry_.generation_of(ref);
  packet.text = name_of(text);
  const ClientIndex owner = registry_.owner_of(ref);
  // What collides is found again when its process is back; the rest is not.
  if (code != Errc::arena_occupied && post_.session_of(owner) == nullptr) {
    auto& missed = missed_notices_[number(owner)];
    if (missed.size() < missed_notices_max) missed.push_back(packet);
    return;
  }
  post_.send(owner, packet_of(packet), {});
}

void Membership::notice_mismatches(const EndpointRef& ref, bool to_all) {
  const auto compare = [&](std::uint32_t p, std::uint32_t s) {
    const PublisherRecord& publisher = registry_.publisher(ref.topic, p);
    const SubscriptionRecord& subscription = registry_.subscription(ref.topic, s);
    if (publisher.state != EndpointState::active || subscription.state != EndpointState::active)
      return;
    const abi::QosPolicy policy =
        abi::qos_mismatch(abi::unpack_qos(publisher.qos), abi::unpack_qos(subscription.qos));
    if (policy == abi::QosPolicy::none) return;
    const std::string text = policy == abi::QosPolicy::reliability
                                 ? "reliable is requested, best effort is offered"
                                 : "transient_local is requested, volatile is offered";
    if (to_all || ref.kind == Kind::publisher)
      notice({Kind::publisher, ref.topic, p}, Errc::qos_incompatible, text, policy);
    if (to_all || ref.kind == Kind::subscription)
      notice({Kind::subscription, ref.topic, s}, Errc::qos_incompatible, text, policy);
  };
  if (ref.kind == Kind::publisher) {
    registry_.for_each_subscription(
        ref.topic, [&](std::uint32_t s, const SubscriptionRecord&) { compare(ref.index, s); });
  } else {
    registry_.for_each_publisher(
        ref.topic, [&](std::uint32_t p, const PublisherRecord&) { compare(p, ref.index); });
  }
}

// For both sides. What may be long comes last: a packet has 255 bytes for it.
std::string Membership::type_mismatch_text(ClientIndex client, TopicIndex topic,
                                           const CreateRequest& request) const {
  const TopicRecord& there = registry_.topic(topic);
  return printable(request.type) + " (layout " + hexadecimal(request.layout_hash) +
         ") is asked for by process " + std::to_string(registry_.client(client).pid) + ", " +
         printable(there.type) + " (layout " + hexadecimal(there.layout_hash) +
         ") is the type of " + std::string(there.name);
}

void Membership::notice_types(ClientIndex client, TopicIndex topic, const std::string& text) {
  auto told = type_notices_[number(client)][number(topic)];
  if (told) return;
  told = true;
  registry_.for_each_publisher(topic, [&](std::uint32_t i, const PublisherRecord& record) {
    if (record.state == EndpointState::active)
      notice({Kind::publisher, topic, i}, Errc::type_mismatch, text);
  });
  registry_.for_each_subscription(topic, [&](std::uint32_t i, const SubscriptionRecord& record) {
    if (record.state == EndpointState::active)
      notice({Kind::subscription, topic, i}, Errc::type_mismatch, text);
  });
}

}  // namespace agnocast::daemon
