// SPDX-License-Identifier: Apache-2.0

#include <daemon/membership.hpp>

#include <base/check.hpp>
#include <base/step.hpp>
#include <journal/cases.hpp>

#include <algorithm>
#include <iterator>

namespace agnocast::daemon {
namespace {

Announced subject_of(const EndpointRef& ref) noexcept {
  return {ref.kind, number(ref.topic), ref.index};
}
Announced region_of(ClientIndex client) noexcept { return {Kind::region, 0, number(client)}; }

wire::Reference reference_to(const EndpointRef& ref, std::uint64_t generation,
                             wire::Opcode opcode) noexcept {
  auto packet = make_body<wire::Reference>(opcode);
  packet.kind = ref.kind;
  packet.topic = number(ref.topic);
  packet.index = ref.index;
  packet.generation = generation;
  return packet;
}

EndpointRef ref_of(const wire::Reference& reference) noexcept {
  return {reference.kind, static_cast<TopicIndex>(reference.topic),
          static_cast<std::uint32_t>(reference.index)};
}

/// The request was carried out and its answer was lost. What is to be refused is refused by
/// the checks that follow.
bool is_done_before(std::uint8_t what, bool again, bool is_so) noexcept {
  return journal::decide_request(what, again,
                                 is_so ? journal::request::done : journal::request::not_done) ==
         journal::RequestDecision::say_done;
}

bool matches(const PublisherRecord& publisher, const SubscriptionRecord& subscription) noexcept {
  return abi::qos_match(abi::unpack_qos(publisher.qos), abi::unpack_qos(subscription.qos));
}

}  // namespace

template <class Function>
void Membership::for_each_told(const AnnounceSet& set, Function function) const {
  for (std::uint32_t i = 0; i < registry_.client_high(); ++i) {
    if (set.contains(i)) function(static_cast<ClientIndex>(i));
  }
}

// --- create

Result<void> Membership::create(ClientIndex client, const CreateRequest& request) {
  const std::uint64_t domain = registry_.client(client).domain;
  auto topic = registry_.find_topic(domain, request.topic);
  if (topic) {
    const TopicRecord& record = registry_.topic(*topic);
    if (record.type != request.type || record.layout_hash != request.layout_hash) {
      const std::string text = type_mismatch_text(client, *topic, request);
      notice_types(client, *topic, text);
      return fail_with(Errc::type_mismatch, text);
    }
  } else {
    const auto added =
        registry_.add_topic({domain, request.topic, request.type, request.layout_hash});
    if (!added) return tl::unexpected(added.error());
    topic = *added;
  }
  auto created = request.kind == Kind::publisher ? create_publisher(client, *topic, request)
                                                 : create_subscription(client, *topic, request);
  if (!created) settle_topic(*topic);
  return created;
}

Result<void> Membership::create_publisher(ClientIndex client, TopicIndex topic,
                                          const CreateRequest& request) {
  const auto plan = registry_.plan_publisher(client, topic, request.qos);
  if (!plan) return explain_full(topic, plan.error());
  const auto ready = regions_.renew(client, plan->extent, abi::publisher_extent_bytes,
                                    abi::slot_offset(abi::ring_count, plan->slot_count));
  if (!ready) return ready;
  // Nobody looks there yet; the add that follows publishes it.
  const dataplane::PublisherWords<SharedMemory> words{regions_.region(client), plan->extent};
  AGNOCAST_CRASH_POINT(B_head);
  words.head().store(abi::pack_entry(plan->first_sequence, 0), std::memory_order_release);
  if (plan->slot_count > abi::near_slot_count) {
    // Its readers will use the hold words behind their link lines.
    Result<void> backed;
    registry_.for_each_subscription(topic, [&](std::uint32_t, const SubscriptionRecord& record) {
      if (backed && regions_.is_open(record.client))
        backed = regions_.back(record.client, record.extent, abi::subscription_extent_bytes);
    });
    if (!backed) return backed;
  }
  registry_.add_publisher(client, topic, request.qos, *plan, request.node, request.request);

  answer_creation({Kind::publisher, topic, plan->index}, request.request);

  const PublisherRecord& publisher = registry_.publisher(topic, plan->index);
  registry_.for_each_subscription(topic, [&](std::uint32_t i, const SubscriptionRecord& record) {
    if (record.state == EndpointState::active && matches(publisher, record))
      announce_publisher(topic, plan->index, i);
  });
  registry_.for_each_subscription(topic, [&](std::uint32_t i, const SubscriptionRecord& record) {
    if (record.state == EndpointState::active && matches(publisher, record))
      announce_subscription(topic, i, plan->index);
  });
  notice_mismatches({Kind::publisher, topic, plan->index});
  return {};
}

Result<void> Membership::create_subscription(ClientIndex client, TopicIndex topic,
                                             const CreateRequest& request) {
  if (!doorbells_.is_open(client, request.executor))
    return fail(Errc::invalid_argument, "the executor of the subscription is not open");
  const auto plan = registry_.plan_subscription(client, topic, request.qos, request.quota);
  if (!plan) return tl::unexpected(plan.error());
  if (auto ready = make_ready(topic, *plan, client, plan->extent); !ready) return ready;
  // Publishers can keep what this one may ask for before it is a member (docs/protocol.md, slots).
  for (const SlotRaise& raise : plan->raises) registry_.raise_slots(topic, raise);
  registry_.add_subscription(client, topic, request.qos, request.quota, request.executor, *plan,
                             request.node, request.request);

  answer_creation({Kind::subscription, topic, plan->index}, request.request);

  const SubscriptionRecord& subscription = registry_.subscription(topic, plan->index);
  registry_.for_each_publisher(topic, [&](std::uint32_t i, const PublisherRecord& record) {
    if (record.state == EndpointState::active && matches(record, subscription))
      announce_publisher(topic, i, plan->index);
  });
  registry_.for_each_publisher(topic, [&](std::uint32_t i, const PublisherRecord& record) {
    if (record.state == EndpointState::active && matches(record, subscription))
      announce_subscription(topic, plan->index, i);
  });
  notice_mismatches({Kind::subscription, topic, plan->index});
  return {};
}

// Whoever is to get a publisher's messages is told before anybody may rely on it, whatever becomes
// of both afterwards.
void Membership::tell_members(const EndpointRef& ref) {
  if (ref.kind == Kind::publisher) {
    const PublisherRecord& own = registry_.publisher(ref.topic, ref.index);
    if (own.state != EndpointState::active) return;
    registry_.for_each_subscription(ref.topic, [&](std::uint32_t, const SubscriptionRecord& other) {
      if (other.state == EndpointState::active && matches(own, other)) tell(ref, other.client);
    });
  } else {
    const SubscriptionRecord& own = registry_.subscription(ref.topic, ref.index);
    if (own.state != EndpointState::active) return;
    registry_.for_each_publisher(ref.topic, [&](std::uint32_t p, const PublisherRecord& other) {
      if (other.state == EndpointState::active && matches(other, own))
        tell({Kind::publisher, ref.topic, p}, own.client);
    });
  }
}

// A daemon that died between the record of the creation and those of the announcements leaves the
// rest to the next one, which is asked again: so every answer tells first.
void Membership::answer_creation(const EndpointRef& ref, std::uint64_t request) {
  tell_members(ref);
  auto answer = make_body<wire::EndpointCreated>(wire::Opcode::endpoint_created, request);
  answer.topic = number(ref.topic);
  answer.index = ref.index;
  answer.generation = registry_.generation_of(ref);
  if (ref.kind == Kind::publisher) {
    const PublisherRecord& record = registry_.publisher(ref.topic, ref.index);
    answer.extent = record.extent;
    answer.slot_count = record.slot_count;
    answer.first_sequence = abi::first_sequence_of(record.generation);
  } else {
    answer.extent = registry_.subscription(ref.topic, ref.index).extent;
  }
  post_.send(registry_.owner_of(ref), packet_of(answer), {});
}

bool Membership::answer_again(ClientIndex client, const CreateRequest& request) {
  const auto ref = registry_.find_creation(client, request.kind, request.request);
  if (!ref) return false;
  ++registry_.counters().requests_answered_again;
  answer_creation(*ref, request.request);
  // What was announced before this answer was for an endpoint that the process did not know yet.
  announce_to_owner(*ref);
  notice_mismatches(*ref, false);
  return true;
}

Result<void> Membership::make_ready(TopicIndex topic, const SubscriptionPlan& plan,
                                    ClientIndex client, std::uint64_t extent) {
  bool far = registry_.uses_far_slots(topic);
  for (const SlotRaise& raise : plan.raises) far = far || raise.slot_count > abi::near_slot_count;
  const std::uint64_t near_bytes = abi::far_hold_offset(abi::publisher_count_max, 0, 0);
  auto ready = regions_.renew(client, extent, abi::subscription_extent_bytes,
                              far ? abi::subscription_extent_bytes : near_bytes);
  for (const SlotRaise& raise : plan.raises) {
    const PublisherRecord& publisher = registry_.publisher(topic, raise.index);
    if (ready && regions_.is_open(publisher.client))
      ready = regions_.back(publisher.client, publisher.extent,
                            abi::slot_offset(abi::ring_count, raise.slot_count));
  }
  if (far) {
    registry_.for_each_subscription(topic, [&](std::uint32_t, const SubscriptionRecord& record) {
      if (ready && regions_.is_open(record.client))
        ready = regions_.back(record.client, record.extent, abi::subscription_extent_bytes);
    });
  }
  return ready;
}

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
  auto packet = make_body<wire::Announcement>(wire::Opcode::announce);
  packet.kind = Kind::publisher;
  packet.topic = number(topic);
  packet.own_index = subscription;
  packet.own_generation = member.generation;
  packet.index = index;
  packet.generation = publisher.generation;
  packet.client = number(publisher.client);
  packet.client_generation = registry_.client(publisher.client).generation;
  packet.extent = publisher.extent;
  packet.qos = publisher.qos;
  packet.first_sequence = abi::first_sequence_of(publisher.generation);
  // One counter for all generations: the publisher joined later.
  packet.from_start = publisher.generation > member.generation ? 1 : 0;
  std::vector<SharedFd> fds{regions_.region_reader(publisher.client)};
  const ClientRecord& owner = registry_.client(publisher.client);
  for (const SharedFd& reader : regions_.window_readers(publisher.client)) {
    const WindowRecord& window = owner.window[packet.window_count];
    packet.window[packet.window_count++] = {window.base, window.bytes, window.first};
    fds.push_back(reader);
  }
  announce({Kind::publisher, topic, index}, member.client, packet, std::move(fds));
  if (on_matched)
    on_matched({Kind::publisher, topic, index}, {Kind::subscription, topic, subscription});
}

void Membership::announce_subscription(TopicIndex topic, std::uint32_t index,
                                       std::uint32_t publisher) {
  const SubscriptionRecord& subscription = registry_.subscription(topic, index);
  const PublisherRecord& member = registry_.publisher(topic, publisher);
  if (tell({Kind::subscription, topic, index}, member.client) == nullptr) return;
  auto packet = make_body<wire::Announcement>(wire::Opcode::announce);
  packet.kind = Kind::subscription;
  packet.topic = number(topic);
  packet.own_index = publisher;
  packet.own_generation = member.generation;
  packet.index = index;
  packet.generation = subscription.generation;
  packet.client = number(subscription.client);
  packet.client_generation = registry_.client(subscription.client).generation;
  packet.extent = subscription.extent;
  packet.qos = subscription.qos;
  packet.executor = subscription.executor;
  const std::uint64_t user_namespace = post_.user_namespace_of(subscription.client);
  const bool same_user =
      registry_.client(subscription.client).uid == registry_.client(member.client).uid &&
      user_namespace != 0 && user_namespace == post_.user_namespace_of(member.client);
  const auto bells =
      doorbells_.for_publisher(subscription.client, subscription.executor, same_user);
  packet.doorbell_count = static_cast<std::uint32_t>(bells.size());
  std::vector<SharedFd> fds{regions_.region_reader(subscription.client)};
  fds.insert(fds.end(), bells.begin(), bells.end());
  announce({Kind::subscription, topic, index}, member.client, packet, std::move(fds));
}

void Membership::announce(const EndpointRef& ref, ClientIndex to, const wire::Announcement& packet,
                          std::vector<SharedFd> fds) {
  Session* const session = post_.session_of(to);
  AGNOCAST_CHECK(session != nullptr);
  // The number of the packet that is about to be handed in.
  session->announcements().announced(subject_of(ref), session->packet_count() + 1);
  session->announcements().announced(region_of(registry_.owner_of(ref)),
                                     session->packet_count() + 1);
  post_.send(to, packet_of(packet), std::move(fds));
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
  for_each_told(record.told, [&](ClientIndex to) {
    Session* const session = post_.session_of(to);
    if (session == nullptr) return;
    session->announcements().announced(region_of(owner), session->packet_count() + 1);
    post_.send(to, packet_of(packet), {reader});
  });
}

// --- after a new connection

// An endpoint's own process is told whom it is connected with: what is there now, and what it was
// told of and has not let go of yet, be it gone or not. Repetitions are the client's to recognise.
void Membership::announce_to_owner(const EndpointRef& ref) {
  const std::uint64_t owner = number(registry_.owner_of(ref));
  if (ref.kind == Kind::subscription) {
    const SubscriptionRecord& own = registry_.subscription(ref.topic, ref.index);
    if (own.state != EndpointState::active && own.state != EndpointState::leaving) return;
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
    if (own.state != EndpointState::active && own.state != EndpointState::orphan) return;
    registry_.for_each_subscription(ref.topic, [&](std::uint32_t s,
                                                   const SubscriptionRecord& other) {
      if (!matches(own, other)) return;
      const bool known = other.told.contains(owner) && (other.state == EndpointState::active ||
                                                        other.state == EndpointState::leaving);
      const bool meets = other.state == EndpointState::active && own.state == EndpointState::active;
      if (known || meets) announce_subscription(ref.topic, s, ref.index);
    });
  }
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
  const std::vector<EndpointRef>& endpoints = registry_.endpoints_of(client);
  for (const EndpointRef& ref : endpoints) say_own(ref);
  for (const EndpointRef& ref : endpoints) announce_to_owner(ref);
  // Nothing is told of a topic in which a process has no endpoint, and with the last one it has let
  // go of everything there.
  std::set<TopicIndex> topics;
  for (const EndpointRef& ref : endpoints) topics.insert(ref.topic);
  for (const TopicIndex topic : topics) {
    registry_.for_each_publisher(topic, [&](std::uint32_t i, const PublisherRecord& record) {
      if (record.state == EndpointState::orphan && record.told.contains(number(client)))
        say_orphaned({Kind::publisher, topic, i}, client);
    });
  }
  for (const TopicIndex topic : topics) {
    registry_.for_each_subscription(topic, [&](std::uint32_t i, const SubscriptionRecord& record) {
      if (record.told.contains(number(client)) && !is_looked_at(topic, record, client))
        post_.send(client,
                   packet_of(reference_to({Kind::subscription, topic, i}, record.generation,
                                          wire::Opcode::forget)),
                   {});
    });
  }
  for (std::uint32_t i = 0; i < registry_.client_high(); ++i) {
    const ClientRecord& record = registry_.client(static_cast<ClientIndex>(i));
    if (record.state == ClientState::free || !record.told.contains(number(client))) continue;
    auto packet = make_body<wire::Reference>(wire::Opcode::region);
    packet.kind = Kind::region;
    packet.index = i;
    packet.generation = record.generation;
    // What the client says of the region before it has read all of this is said too early.
    Session* const session = post_.session_of(client);
    AGNOCAST_CHECK(session != nullptr);
    session->announcements().announced(region_of(static_cast<ClientIndex>(i)),
                                       session->packet_count() + 1);
    post_.send(client, packet_of(packet), {});
  }
  const auto missed = missed_notices_.extract(number(client));
  if (missed.empty()) return;
  for (const wire::Notice& packet : missed.mapped()) post_.send(client, packet_of(packet), {});
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
  if (!type_notices_.insert({number(client), number(topic)}).second) return;
  registry_.for_each_publisher(topic, [&](std::uint32_t i, const PublisherRecord& record) {
    if (record.state == EndpointState::active)
      notice({Kind::publisher, topic, i}, Errc::type_mismatch, text);
  });
  registry_.for_each_subscription(topic, [&](std::uint32_t i, const SubscriptionRecord& record) {
    if (record.state == EndpointState::active)
      notice({Kind::subscription, topic, i}, Errc::type_mismatch, text);
  });
}

// --- leave

bool Membership::is_own(ClientIndex client, const wire::Reference& reference) const {
  const EndpointRef ref = ref_of(reference);
  if (!registry_.was_used(ref)) return false;
  const EndpointState state = ref.kind == Kind::publisher
                                  ? registry_.publisher(ref.topic, ref.index).state
                                  : registry_.subscription(ref.topic, ref.index).state;
  return state != EndpointState::free && registry_.owner_of(ref) == client &&
         registry_.generation_of(ref) == reference.generation;
}

bool Membership::is_active(ClientIndex client, const wire::Reference& reference) const {
  if (!is_own(client, reference)) return false;
  const EndpointRef ref = ref_of(reference);
  return EndpointState::active == (ref.kind == Kind::publisher
                                       ? registry_.publisher(ref.topic, ref.index).state
                                       : registry_.subscription(ref.topic, ref.index).state);
}

bool Membership::is_drained(ClientIndex client, const wire::Reference& reference) const {
  if (!is_own(client, reference)) return true;
  const EndpointRef ref = ref_of(reference);
  return ref.kind == Kind::subscription &&
         registry_.subscription(ref.topic, ref.index).state == EndpointState::over;
}

Result<void> Membership::leave(ClientIndex client, const LeaveRequest& request) {
  const wire::Reference& reference = request.reference;
  if (is_done_before(journal::request::leave, request.again, !is_active(client, reference))) {
    ++registry_.counters().requests_answered_again;
    return say_done(client, reference);
  }
  if (!is_own(client, reference))
    return fail(Errc::protocol_violation, "this is not an endpoint of the process");
  const EndpointRef ref = ref_of(reference);
  if (ref.kind == Kind::publisher) {
    const PublisherRecord& record = registry_.publisher(ref.topic, ref.index);
    if (record.state != EndpointState::active)
      return fail(Errc::protocol_violation, "the publisher has left before");
    const dataplane::PublisherWords<SharedMemory> words{regions_.region(client), record.extent};
    // What the process wrote; readers check it like any other value of a publisher.
    orphan(ref, words.head().load(std::memory_order_acquire), journal::LeaveCause::left);
  } else {
    if (registry_.subscription(ref.topic, ref.index).state != EndpointState::active)
      return fail(Errc::protocol_violation, "the subscription has left before");
    registry_.change_subscription(ref.topic, ref.index, EndpointState::leaving);
    kick_publishers_of(ref);
  }
  const auto done = say_done(client, reference);
  settle(ref);
  return done;
}

Result<void> Membership::drained(ClientIndex client, const DrainedRequest& request) {
  const wire::Reference& reference = request.reference;
  if (is_done_before(journal::request::drained, request.again, is_drained(client, reference))) {
    ++registry_.counters().requests_answered_again;
    return say_done(client, reference);
  }
  if (!is_own(client, reference))
    return fail(Errc::protocol_violation, "this is not an endpoint of the process");
  const EndpointRef ref = ref_of(reference);
  const bool publisher = ref.kind == Kind::publisher;
  const EndpointState expected = publisher ? EndpointState::over : EndpointState::leaving;
  const EndpointState state = publisher ? registry_.publisher(ref.topic, ref.index).state
                                        : registry_.subscription(ref.topic, ref.index).state;
  if (state != expected)
    return fail(Errc::protocol_violation, publisher ? "the publisher's word is not free yet"
                                                    : "the subscription has not left");
  Result<void> done;
  if (publisher) {
    registry_.end_publisher(ref.topic, ref.index, EndpointState::free);
    done = say_done(client, reference);
    bool last = true;
    registry_.for_each_publisher(ref.topic, [&](std::uint32_t, const PublisherRecord& record) {
      last = last && record.client != client;
    });
    // What it had attached is detached with it.
    if (last) {
      registry_.for_each_subscription(ref.topic, [&](std::uint32_t i, const SubscriptionRecord&) {
        let_go({Kind::subscription, ref.topic, i}, client);
      });
    }
  } else {
    registry_.change_subscription(ref.topic, ref.index, EndpointState::over);
    done = say_done(client, reference);
    registry_.for_each_publisher(ref.topic, [&](std::uint32_t p, const PublisherRecord& record) {
      bool other = false;
      registry_.for_each_subscription(
          ref.topic, [&](std::uint32_t s, const SubscriptionRecord& subscription) {
            other = other || (s != ref.index && subscription.client == client &&
                              (subscription.state == EndpointState::active ||
                               subscription.state == EndpointState::leaving) &&
                              matches(record, subscription));
          });
      if (!other) let_go({Kind::publisher, ref.topic, p}, client);
    });
    forget_subscription(ref);
    settle(ref);
  }
  settle_topic(ref.topic);
  return done;
}

Result<void> Membership::say_done(ClientIndex client, const wire::Reference& reference) {
  const auto answer = make_body<wire::Done>(wire::Opcode::done, reference.header.request);
  post_.send(client, packet_of(answer), {});
  return {};
}

Result<void> Membership::unlinked(ClientIndex client, const wire::Unlinked& statement) {
  Session* const session = post_.session_of(client);
  AGNOCAST_CHECK(session != nullptr);
  if (statement.seen > session->packet_count())
    return fail(Errc::protocol_violation, "more packets were seen than were sent");
  if (statement.kind == Kind::region) {
    const ClientIndex owner{static_cast<std::uint32_t>(statement.index)};
    if (number(owner) >= registry_.client_high() ||
        registry_.client(owner).state == ClientState::free ||
        registry_.client(owner).generation != statement.generation)
      return {};  // late: it is over
    if (session->announcements().is_void(region_of(owner), statement.seen)) return {};
    for (const EndpointRef& ref : registry_.endpoints_of(owner)) {
      if (registry_.told_of(ref).contains(number(client)))
        return fail(Errc::protocol_violation, "something of this region is linked");
    }
    session->announcements().forget(region_of(owner));
    registry_.let_go_of_region(owner, client);
    settle_client(owner);
    return {};
  }
  const EndpointRef ref{statement.kind, static_cast<TopicIndex>(statement.topic),
                        static_cast<std::uint32_t>(statement.index)};
  if (!registry_.was_used(ref) || registry_.generation_of(ref) != statement.generation ||
      session->announcements().is_void(subject_of(ref), statement.seen))
    return {};
  session->announcements().forget(subject_of(ref));
  let_go(ref, client);
  return {};
}

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
      given_up_.contains(packet.generation) ? 0 : registry_.final_head_of(ref.topic, ref.index);
  post_.send(to, packet_of(packet), {});
}

// Only asked for: an index is free when everybody has said `unlinked`, as ever.
void Membership::limit_orphans(TopicIndex topic) {
  std::vector<std::pair<std::uint64_t, std::uint32_t>> orphans;  // generation, index: oldest first
  registry_.for_each_publisher(topic, [&](std::uint32_t i, const PublisherRecord& record) {
    if (record.state == EndpointState::orphan) orphans.emplace_back(record.generation, i);
  });
  const std::size_t limit = std::clamp<std::size_t>(registry_.capacity().publishers_per_topic / 2,
                                                    1, abi::orphan_count_max);
  if (orphans.size() <= limit) return;
  std::sort(orphans.begin(), orphans.end());
  orphans.resize(orphans.size() - limit);
  for (const auto& [generation, index] : orphans) {
    if (!given_up_.insert(generation).second) continue;
    const EndpointRef ref{Kind::publisher, topic, index};
    for_each_told(registry_.told_of(ref), [&](ClientIndex to) { say_orphaned(ref, to); });
  }
}

// Whoever keeps publishers that are gone is named: it is stopped, or broken, and can be revoked.
tl::unexpected<Failure> Membership::explain_full(TopicIndex topic, const Failure& why) const {
  std::uint64_t orphans = 0;
  std::vector<std::uint64_t> kept(registry_.client_high(), 0);
  registry_.for_each_publisher(topic, [&](std::uint32_t, const PublisherRecord& record) {
    if (record.state != EndpointState::orphan) return;
    ++orphans;
    for_each_told(record.told, [&](ClientIndex by) { ++kept[number(by)]; });
  });
  const auto most = std::max_element(kept.begin(), kept.end());
  if (why.code != Errc::limit_reached || most == kept.end() || *most == 0)
    return tl::unexpected(why);
  const ClientRecord& process =
      registry_.client(static_cast<ClientIndex>(std::distance(kept.begin(), most)));
  return fail_with(Errc::limit_reached,
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
  if (!registry_.told_of(ref).reusable()) return;
  AGNOCAST_CRASH_POINT(B_settle);
  const ClientIndex owner = registry_.owner_of(ref);
  const bool owner_dead = !registry_.is_alive(owner);
  if (ref.kind == Kind::publisher) {
    const EndpointState state = registry_.publisher(ref.topic, ref.index).state;
    if (state != EndpointState::orphan && state != EndpointState::over) return;
    given_up_.erase(registry_.generation_of(ref));
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
    if (state != EndpointState::over && state != EndpointState::dead) return;
    registry_.free_subscription(ref.topic, ref.index);
  }
  settle_topic(ref.topic);
  settle_client(owner);
}

void Membership::settle_topic(TopicIndex topic) {
  if (registry_.topic(topic).state != TopicState::used || !registry_.topic_is_empty(topic)) return;
  registry_.free_topic(topic);
  std::erase_if(type_notices_, [&](const auto& entry) { return entry.second == number(topic); });
}

void Membership::settle_client(ClientIndex client) {
  if (!registry_.can_end(client)) return;
  registry_.end_client(client);
  if (on_ended) on_ended(client);
}

void Membership::forget_client(ClientIndex client) {
  registry_.client_forgotten(client);
  missed_notices_.erase(number(client));
  std::erase_if(type_notices_, [&](const auto& entry) { return entry.first == number(client); });
}

// drained() has two halves: its own record, and one for each thing that its process has let go of
// with it. The second half follows from what the tables say then.
void Membership::finish() {
  const auto lets_go = [&](const EndpointRef& ref, auto has_use) {
    std::vector<ClientIndex> gone;
    for_each_told(registry_.told_of(ref), [&](ClientIndex to) {
      if (registry_.is_alive(to) && !has_use(to)) gone.push_back(to);
    });
    for (const ClientIndex client : gone) let_go(ref, client);
  };
  for (std::uint32_t t = 0; t < registry_.topic_high(); ++t) {
    const TopicIndex topic{t};
    // The topic goes with its last endpoint, in the middle of this.
    const auto is_used = [&] { return registry_.topic(topic).state == TopicState::used; };
    for (std::uint32_t p = 0; is_used() && p < registry_.topic(topic).publisher_high; ++p) {
      const PublisherRecord& publisher = registry_.publisher(topic, p);
      if (publisher.state == EndpointState::free) continue;
      lets_go({Kind::publisher, topic, p}, [&](ClientIndex to) {
        bool uses = false;
        registry_.for_each_subscription(topic, [&](std::uint32_t, const SubscriptionRecord& own) {
          uses = uses ||
                 (own.client == to &&
                  (own.state == EndpointState::active || own.state == EndpointState::leaving) &&
                  matches(publisher, own));
        });
        return uses;
      });
    }
    for (std::uint32_t s = 0; is_used() && s < registry_.topic(topic).subscription_high; ++s) {
      if (registry_.subscription(topic, s).state == EndpointState::free) continue;
      lets_go({Kind::subscription, topic, s}, [&](ClientIndex to) {
        bool uses = false;
        registry_.for_each_publisher(topic, [&](std::uint32_t, const PublisherRecord& own) {
          uses = uses || own.client == to;
        });
        return uses;
      });
    }
  }
  settle_all();
  // Who comes back is told at once whom to let go of.
  for (std::uint32_t t = 0; t < registry_.topic_high(); ++t) {
    if (registry_.topic(TopicIndex{t}).state == TopicState::used) limit_orphans(TopicIndex{t});
  }
}

void Membership::settle_all() {
  for (std::uint32_t t = 0; t < registry_.topic_high(); ++t) {
    const TopicIndex topic{t};
    for (std::uint32_t i = 0; i < registry_.topic(topic).publisher_high; ++i) {
      if (registry_.topic(topic).state == TopicState::used) settle({Kind::publisher, topic, i});
    }
    for (std::uint32_t i = 0; i < registry_.topic(topic).subscription_high; ++i) {
      if (registry_.topic(topic).state == TopicState::used) settle({Kind::subscription, topic, i});
    }
    settle_topic(topic);
  }
  for (std::uint32_t c = 0; c < registry_.client_high(); ++c)
    settle_client(static_cast<ClientIndex>(c));
}

}  // namespace agnocast::daemon
