// SPDX-License-Identifier: Apache-2.0
//
// Announcing: see the header.

#include <daemon/lifecycle/announcing.hpp>

#include <daemon/lifecycle/references.hpp>
#include <journal/mismatch.hpp>

#include <algorithm>
#include <string>

namespace agnocast::daemon {

Effects Announcing::created(const EndpointRef& ref, std::uint64_t request) const {
  Effects effects = records_of_members(ref);
  effects.push_back(answer(ref, request));
  // Readers are notified of a publisher before the publisher is of them: they have mapped it when
  // it rings them.
  Effects to_publishers;
  const auto meet = [&](const EndpointRef& publisher, const EndpointRef& subscription) {
    effects.push_back(effect::Announce{publisher, subscription});
    to_publishers.push_back(effect::Announce{subscription, publisher});
  };
  if (ref.kind == Kind::publisher) {
    const PublisherRecord& own = registry_.publisher(ref.topic, ref.index);
    registry_.for_each_subscription(
        ref.topic, [&](std::uint32_t s, const SubscriptionRecord& other) {
          if (other.state == EndpointState::active && matches(own, other))
            meet(ref, {Kind::subscription, ref.topic, s});
        });
  } else {
    const SubscriptionRecord& own = registry_.subscription(ref.topic, ref.index);
    registry_.for_each_publisher(ref.topic, [&](std::uint32_t p, const PublisherRecord& other) {
      if (other.state == EndpointState::active && matches(other, own))
        meet({Kind::publisher, ref.topic, p}, ref);
    });
  }
  append(effects, to_publishers);
  append(effects, mismatches(ref, true));
  return effects;
}

Effects Announcing::answered_again(const EndpointRef& ref, std::uint64_t request) const {
  Effects effects{effect::CountAnsweredAgain{}};
  append(effects, records_of_members(ref));
  effects.push_back(answer(ref, request));
  // The client did not know the endpoint yet when it got earlier announcements for it.
  append(effects, to_owner(ref));
  append(effects, mismatches(ref, false));
  return effects;
}

Effects Announcing::records_of_members(const EndpointRef& ref) const {
  Effects effects;
  if (state_of(registry_, ref) != EndpointState::active) return effects;
  if (ref.kind == Kind::publisher) {
    const PublisherRecord& own = registry_.publisher(ref.topic, ref.index);
    registry_.for_each_subscription(ref.topic, [&](std::uint32_t, const SubscriptionRecord& other) {
      if (other.state == EndpointState::active && matches(own, other))
        effects.push_back(effect::RecordNotified{ref, other.client});
    });
  } else {
    const SubscriptionRecord& own = registry_.subscription(ref.topic, ref.index);
    registry_.for_each_publisher(ref.topic, [&](std::uint32_t p, const PublisherRecord& other) {
      if (other.state == EndpointState::active && matches(other, own))
        effects.push_back(effect::RecordNotified{{Kind::publisher, ref.topic, p}, own.client});
    });
  }
  return effects;
}

effect::Send Announcing::answer(const EndpointRef& ref, std::uint64_t request) const {
  auto packet = make_body<wire::EndpointCreated>(wire::Opcode::endpoint_created, request);
  packet.topic = number(ref.topic);
  packet.index = ref.index;
  packet.generation = registry_.generation_of(ref);
  if (ref.kind == Kind::publisher) {
    const PublisherRecord& record = registry_.publisher(ref.topic, ref.index);
    packet.extent = record.extent;
    packet.slot_count = record.slot_count;
    packet.first_sequence = abi::first_sequence_of(record.generation);
  } else {
    packet.extent = registry_.subscription(ref.topic, ref.index).extent;
  }
  return {registry_.owner_of(ref), packet};
}

// Includes the current peers, and those that were announced and not acknowledged yet, gone or not.
// The client recognises repetitions.
Effects Announcing::to_owner(const EndpointRef& ref) const {
  Effects effects;
  if (ref.kind == Kind::publisher) {
    const PublisherRecord& own = registry_.publisher(ref.topic, ref.index);
    registry_.for_each_subscription(
        ref.topic, [&](std::uint32_t s, const SubscriptionRecord& other) {
          if (is_to_know(own, other))
            effects.push_back(effect::Announce{{Kind::subscription, ref.topic, s}, ref});
        });
    return effects;
  }
  const SubscriptionRecord& own = registry_.subscription(ref.topic, ref.index);
  if (own.state != EndpointState::active && own.state != EndpointState::leaving) return effects;
  registry_.for_each_publisher(ref.topic, [&](std::uint32_t p, const PublisherRecord& other) {
    if (!matches(other, own)) return;
    // No subscription joins an orphan.
    const bool drains = other.state == EndpointState::orphan && own.generation <= other.last_joined;
    const bool known = other.notified.contains(number(own.client)) &&
                       (other.state == EndpointState::active || drains);
    const bool meets = other.state == EndpointState::active && own.state == EndpointState::active;
    if (known || meets) effects.push_back(effect::Announce{{Kind::publisher, ref.topic, p}, ref});
  });
  return effects;
}

Effects Announcing::to_publishers_of(const EndpointRef& subscription) const {
  Effects effects;
  const SubscriptionRecord& own = registry_.subscription(subscription.topic, subscription.index);
  registry_.for_each_publisher(subscription.topic, [&](std::uint32_t p,
                                                       const PublisherRecord& publisher) {
    if (is_to_know(publisher, own))
      effects.push_back(effect::Announce{subscription, {Kind::publisher, subscription.topic, p}});
  });
  return effects;
}

bool Announcing::is_to_know(const PublisherRecord& own, const SubscriptionRecord& other) const {
  if (!matches(own, other)) return false;
  const bool is_active = own.state == EndpointState::active;
  if (is_active && other.state == EndpointState::active) return true;
  return (is_active || own.state == EndpointState::orphan) &&
         (other.state == EndpointState::active || other.state == EndpointState::leaving) &&
         other.notified.contains(number(own.client));
}

bool Announcing::is_looked_at(TopicIndex topic, const SubscriptionRecord& subscription,
                              ClientIndex by) const {
  if (subscription.state != EndpointState::active && subscription.state != EndpointState::leaving)
    return false;
  const auto& endpoints = registry_.endpoints_of(by);
  return std::any_of(endpoints.begin(), endpoints.end(), [&](const EndpointRef& ref) {
    if (ref.kind != Kind::publisher || ref.topic != topic) return false;
    const PublisherRecord& record = registry_.publisher(topic, ref.index);
    return record.state != EndpointState::over && matches(record, subscription);
  });
}

Effects Announcing::own(const EndpointRef& ref) const {
  auto packet = make_body<wire::Own>(wire::Opcode::own);
  packet.kind = ref.kind;
  packet.topic = number(ref.topic);
  packet.index = ref.index;
  packet.generation = registry_.generation_of(ref);
  packet.creation = ref.kind == Kind::publisher
                        ? registry_.publisher(ref.topic, ref.index).creation
                        : registry_.subscription(ref.topic, ref.index).creation;
  packet.active = state_of(registry_, ref) == EndpointState::active ? 1 : 0;
  return {effect::Send{registry_.owner_of(ref), packet}};
}

Effects Announcing::what_is_over(ClientIndex client, TopicIndex topic) const {
  Effects effects;
  registry_.for_each_publisher(topic, [&](std::uint32_t i, const PublisherRecord& record) {
    if (record.state == EndpointState::orphan && record.notified.contains(number(client)))
      effects.push_back(effect::Send{client, endings_.orphaned({Kind::publisher, topic, i})});
  });
  registry_.for_each_subscription(topic, [&](std::uint32_t i, const SubscriptionRecord& record) {
    if (record.notified.contains(number(client)) && !is_looked_at(topic, record, client))
      effects.push_back(effect::Send{
          client,
          reference_to({Kind::subscription, topic, i}, record.generation, wire::Opcode::forget)});
  });
  return effects;
}

Effects Announcing::mismatches(const EndpointRef& ref, bool to_both) const {
  Effects effects;
  const auto compare = [&](std::uint32_t p, std::uint32_t s) {
    const PublisherRecord& publisher = registry_.publisher(ref.topic, p);
    const SubscriptionRecord& subscription = registry_.subscription(ref.topic, s);
    if (publisher.state != EndpointState::active || subscription.state != EndpointState::active)
      return;
    const abi::Qos offered = abi::unpack_qos(publisher.qos);
    const abi::Qos requested = abi::unpack_qos(subscription.qos);
    if (requested.ignore_local && publisher.client == subscription.client) return;
    const abi::QosPolicy policy = abi::qos_mismatch(offered, requested);
    if (policy == abi::QosPolicy::none) return;
    const std::string text = journal::mismatch_text(offered, requested);
    for (const EndpointRef& to : {EndpointRef{Kind::publisher, ref.topic, p},
                                  EndpointRef{Kind::subscription, ref.topic, s}}) {
      if (to_both || to.kind == ref.kind)
        effects.push_back(effect::Notice{to, Errc::qos_incompatible, text, policy});
    }
  };
  if (ref.kind == Kind::publisher) {
    registry_.for_each_subscription(
        ref.topic, [&](std::uint32_t s, const SubscriptionRecord&) { compare(ref.index, s); });
  } else {
    registry_.for_each_publisher(
        ref.topic, [&](std::uint32_t p, const PublisherRecord&) { compare(p, ref.index); });
  }
  return effects;
}

}  // namespace agnocast::daemon
