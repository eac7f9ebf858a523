// SPDX-License-Identifier: Apache-2.0
//
// ClientDeath: the states of a client whose session is over, from the record of its death until
// its place is free. A core without I/O: it reads the registry and returns the next step; Reaping
// (reaper.hpp) carries it out.
//
//     ClientState    state            verb → function
//
//     alive
//       │                             die: record its death → Registry::client_died, by Reaping()
//       ▼
//     dead           closing          close its subscriptions → Endings::close_subscription
//       │            orphaning        orphan its publishers, with their queues repaired → Endings::orphan
//       │            unmapping        unmap its region in the daemon → Regions::unmap_client
//       │            acknowledging    acknowledge for it what was announced to it, topic by topic
//       │                               → Registry::acknowledge_topic; then Endings::free_unused of each place
//       │            forgetting       forget it: remove it from the announce sets of regions, and its doorbells
//       │                               → EndpointManager::forget_client, Doorbells::close_client
//       ▼
//     forgotten      forgotten        free its place, when no process has its region any more
//       │                               → Endings::free_unused_client
//       ▼
//     free
//
// A revoked client goes the same way while its process lives, and stays `forgotten` until that
// ends (ClientTermination::free_revoked). journal/cases.hpp decides with which of these states a
// daemon that starts begins: its `recover` and `finish` are the first one, its `settle` is the
// last one.
//
// Invariants: from `orphaning` on no subscription of it is active or leaving; from `unmapping` on
// no publisher of it is active; from `forgetting` on no announce set of an endpoint has it. The
// daemon may die in each state: the tables have `dead`, so the next daemon begins again with
// `closing` and finds completed steps done. A daemon that dies in `forgotten` leaves nothing to
// repeat.
#pragma once

#include <daemon/state/registry.hpp>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <set>
#include <variant>
#include <vector>

namespace agnocast::daemon {

enum class DeathState : std::uint8_t {
  closing,
  orphaning,
  unmapping,
  acknowledging,
  forgetting,
  forgotten,
};

namespace death {
struct Close {
  EndpointRef subscription;
};
struct Orphan {
  EndpointRef publisher;
};
struct Unmap {};
struct Acknowledge {
  TopicIndex topic{};
};
/// For each place in turn of a topic that it knew.
struct FreeUnused {
  EndpointRef ref;
};
struct Forget {};
}  // namespace death

using DeathStep = std::variant<death::Close, death::Orphan, death::Unmap, death::Acknowledge,
                               death::FreeUnused, death::Forget>;

class ClientDeath {
 public:
  /// `client` is dead in the tables.
  ClientDeath(ClientIndex client, const Registry& registry);

  /// Returns the next step; nothing: it is forgotten. The caller has carried out earlier steps; to
  /// others that it served meanwhile, the rest of the client looks alive.
  std::optional<DeathStep> next();
  DeathState state() const noexcept { return state_; }
  ClientIndex client() const noexcept { return client_; }

 private:
  bool is_ours(const EndpointRef& ref) const noexcept;
  std::optional<DeathStep> next_close();
  std::optional<DeathStep> next_orphan();
  std::optional<DeathStep> next_acknowledge();

  ClientIndex client_;
  const Registry& registry_;
  DeathState state_ = DeathState::closing;
  std::vector<EndpointRef> endpoints_;  // as of the beginning: they go one by one
  std::size_t next_endpoint_ = 0;       // to close, then to orphan
  std::set<TopicIndex> topics_;         // topics of those endpoints, yet to be acknowledged
  std::vector<EndpointRef> to_free_;    // places of one topic, the last one first
};

}  // namespace agnocast::daemon
