// SPDX-License-Identifier: Apache-2.0
//
// Membership, requests: who creates an endpoint, leaves, has drained, has unlinked. Whom that concerns
// and how they hear of it: membership_announce.cpp; what is over then: membership_end.cpp.

#include <base/check.hpp>
#include <daemon/lifecycle/membership_parts.hpp>
#include <daemon/state/steps.hpp>
#include <journal/cases.hpp>

namespace agnocast::daemon {
namespace {

/// The request was carried out and its answer was lost. What is to be refused is refused by
/// the checks that follow.
bool is_done_before(std::uint8_t what, bool again, bool is_so) noexcept {
  return journal::decide_request(what, again,
                                 is_so ? journal::request::done : journal::request::not_done) ==
         journal::RequestDecision::say_done;
}

}  // namespace

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
  const auto ready = regions_.renew(client, {plan->extent, abi::publisher_extent_bytes},
                                    abi::slot_offset(abi::ring_count, plan->slot_count));
  if (!ready) return ready;
  // Nobody looks there yet; the add that follows publishes it.
  const region::PublisherWords<SharedMemory> words{regions_.region(client), plan->extent};
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
  const HoldPool pool = registry_.hold_pool();
  const HoldPool::Use use = registry_.pool_use(registry_.client(client).uid, topic);
  const HoldQuota quota{request.quota, request.quota_or_less
                                           ? pool.part(use, request.quota)
                                           : std::min(request.quota, pool.at_most(use))};
  const auto plan = registry_.plan_subscription(client, topic, request.qos, quota);
  if (!plan) return tl::unexpected(plan.error());
  if (auto ready = make_ready(topic, *plan, client, plan->extent); !ready) return ready;
  // Publishers can keep what this one may ask for before it is a member (docs/protocol.md, slots).
  for (const SlotRaise& raise : plan->raises) registry_.raise_slots(topic, raise);
  registry_.add_subscription(client, topic, request.qos, quota, request.executor, *plan,
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
  auto ready = regions_.renew(client, {extent, abi::subscription_extent_bytes},
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

// --- leave

bool Membership::is_own(ClientIndex client, const wire::Reference& reference) const {
  const EndpointRef ref = ref_of(reference);
  if (!registry_.is_used(ref)) return false;
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
    say_done(client, reference);
    return {};
  }
  if (!is_own(client, reference))
    return fail(Errc::protocol_violation, "this is not an endpoint of the process");
  const EndpointRef ref = ref_of(reference);
  if (ref.kind == Kind::publisher) {
    const PublisherRecord& record = registry_.publisher(ref.topic, ref.index);
    if (record.state != EndpointState::active)
      return fail(Errc::protocol_violation, "the publisher has left before");
    const region::PublisherWords<SharedMemory> words{regions_.region(client), record.extent};
    // What the process wrote; readers check it like any other value of a publisher.
    orphan(ref, words.head().load(std::memory_order_acquire), journal::LeaveCause::left);
  } else {
    if (registry_.subscription(ref.topic, ref.index).state != EndpointState::active)
      return fail(Errc::protocol_violation, "the subscription has left before");
    registry_.change_subscription(ref.topic, ref.index, EndpointState::leaving);
    kick_publishers_of(ref);
  }
  say_done(client, reference);
  settle(ref);
  return {};
}

Result<void> Membership::drained(ClientIndex client, const DrainedRequest& request) {
  const wire::Reference& reference = request.reference;
  if (is_done_before(journal::request::drained, request.again, is_drained(client, reference))) {
    ++registry_.counters().requests_answered_again;
    say_done(client, reference);
    return {};
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
  if (publisher) {
    registry_.end_publisher(ref.topic, ref.index, EndpointState::free);
    say_done(client, reference);
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
    say_done(client, reference);
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
  return {};
}

void Membership::say_done(ClientIndex client, const wire::Reference& reference) {
  const auto answer = make_body<wire::Done>(wire::Opcode::done, reference.header.request);
  post_.send(client, packet_of(answer), {});
}

bool Membership::may_judge(ClientIndex client, const Announced& subject, std::uint64_t seen) {
  if (!post_.session_of(client)->announcements().may_be_void(subject, seen)) return true;
  post_.begin_anew(
      client, "what was announced to the processes of its user is more than the daemon remembers");
  return false;
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
    // Who is not told everything yet is asked again when it is.
    if (tells(client) || session->announcements().is_void(region_of(owner), statement.seen) ||
        !may_judge(client, region_of(owner), statement.seen))
      return {};
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
  if (!registry_.is_used(ref) || registry_.generation_of(ref) != statement.generation ||
      session->announcements().is_void(subject_of(ref), statement.seen) ||
      !may_judge(client, subject_of(ref), statement.seen))
    return {};
  session->announcements().forget(subject_of(ref));
  let_go(ref, client);
  return {};
}

}  // namespace agnocast::daemon
