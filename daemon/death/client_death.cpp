// SPDX-License-Identifier: Apache-2.0
//
// ClientDeath: see the header.

#include <daemon/death/client_death.hpp>

namespace agnocast::daemon {

ClientDeath::ClientDeath(ClientIndex client, const Registry& registry)
    : client_(client), registry_(registry), endpoints_(registry.endpoints_of(client)) {
  for (const EndpointRef& ref : endpoints_) topics_.insert(ref.topic);
}

std::optional<DeathStep> ClientDeath::next() {
  std::optional<DeathStep> step;
  while (!step && state_ != DeathState::forgotten) {
    const DeathState before = state_;
    switch (before) {
      case DeathState::closing:
        step = next_close();
        break;
      case DeathState::orphaning:
        step = next_orphan();
        break;
      case DeathState::unmapping:
        state_ = DeathState::acknowledging;
        return death::Unmap{};
      case DeathState::acknowledging:
        step = next_acknowledge();
        break;
      case DeathState::forgetting:
        state_ = DeathState::forgotten;
        return death::Forget{};
      case DeathState::forgotten:
        break;
    }
    if (step) return step;
    state_ = static_cast<DeathState>(static_cast<std::uint8_t>(before) + 1);
    next_endpoint_ = 0;
  }
  return step;
}

// A place that became free meanwhile may have another owner by now.
bool ClientDeath::is_ours(const EndpointRef& ref) const noexcept {
  return registry_.is_used(ref) && registry_.owner_of(ref) == client_;
}

std::optional<DeathStep> ClientDeath::next_close() {
  while (next_endpoint_ < endpoints_.size()) {
    const EndpointRef& ref = endpoints_[next_endpoint_++];
    if (ref.kind != Kind::subscription || !is_ours(ref)) continue;
    const EndpointState state = registry_.subscription(ref.topic, ref.index).state;
    if (state == EndpointState::active || state == EndpointState::leaving) return death::Close{ref};
  }
  return std::nullopt;
}

std::optional<DeathStep> ClientDeath::next_orphan() {
  while (next_endpoint_ < endpoints_.size()) {
    const EndpointRef& ref = endpoints_[next_endpoint_++];
    if (ref.kind == Kind::publisher && is_ours(ref) &&
        registry_.publisher(ref.topic, ref.index).state == EndpointState::active)
      return death::Orphan{ref};
  }
  return std::nullopt;
}

// Places to free lie in the topics that it knew, and in those of its own endpoints. None of its
// endpoints is active by now, so nothing new is announced to it.
std::optional<DeathStep> ClientDeath::next_acknowledge() {
  if (!to_free_.empty()) {
    const EndpointRef ref = to_free_.back();
    to_free_.pop_back();
    return death::FreeUnused{ref};
  }
  std::optional<TopicIndex> topic = registry_.known_topic_of(client_);
  if (!topic && !topics_.empty()) topic = *topics_.begin();
  if (!topic) return std::nullopt;
  for (const Kind kind : {Kind::subscription, Kind::publisher}) {
    for (auto at = registry_.next_place(kind, *topic, 0); at;
         at = registry_.next_place(kind, *topic, *at + 1))
      to_free_.push_back({kind, *topic, *at});
  }
  topics_.erase(*topic);  // behind what may fail
  return death::Acknowledge{*topic};
}

}  // namespace agnocast::daemon
