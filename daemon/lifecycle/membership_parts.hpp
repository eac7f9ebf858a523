// SPDX-License-Identifier: Apache-2.0
//
// What the three files of Membership share: names for the same thing in tables, packets and the book of
// announcements.
#pragma once

#include <daemon/lifecycle/membership.hpp>

namespace agnocast::daemon {

inline Announced subject_of(const EndpointRef& ref) noexcept {
  return {ref.kind, number(ref.topic), ref.index};
}
inline Announced region_of(ClientIndex client) noexcept {
  return {Kind::region, 0, number(client)};
}

inline wire::Reference reference_to(const EndpointRef& ref, std::uint64_t generation,
                                    wire::Opcode opcode) noexcept {
  auto packet = make_body<wire::Reference>(opcode);
  packet.kind = ref.kind;
  packet.topic = number(ref.topic);
  packet.index = ref.index;
  packet.generation = generation;
  return packet;
}

inline EndpointRef ref_of(const wire::Reference& reference) noexcept {
  return {reference.kind, static_cast<TopicIndex>(reference.topic),
          static_cast<std::uint32_t>(reference.index)};
}

inline bool matches(const PublisherRecord& publisher,
                    const SubscriptionRecord& subscription) noexcept {
  return abi::qos_match(abi::unpack_qos(publisher.qos), abi::unpack_qos(subscription.qos));
}

template <class Function>
void Membership::for_each_told(const AnnounceSet& set, Function function) const {
  for (std::uint32_t i = 0; i < registry_.client_high(); ++i) {
    if (set.contains(i)) function(static_cast<ClientIndex>(i));
  }
}

}  // namespace agnocast::daemon
