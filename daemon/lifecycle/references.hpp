// SPDX-License-Identifier: Apache-2.0
//
// Names for the same thing in tables, packets and the notes of announcements, and questions to the
// registry that several decisions share.
#pragma once

#include <daemon/state/registry.hpp>
#include <daemon/transport/client_channel.hpp>
#include <daemon/transport/session.hpp>

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

inline EndpointState state_of(const Registry& registry, const EndpointRef& ref) noexcept {
  return ref.kind == Kind::publisher ? registry.publisher(ref.topic, ref.index).state
                                     : registry.subscription(ref.topic, ref.index).state;
}

/// Calls function(client) for each process in the announce set.
template <class Function>
void for_each_notified(const Registry& registry, const AnnounceSet& set, Function function) {
  for (std::uint32_t i = 0; i < registry.client_high(); ++i) {
    if (set.contains(i)) function(static_cast<ClientIndex>(i));
  }
}

}  // namespace agnocast::daemon
