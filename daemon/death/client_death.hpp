// SPDX-License-Identifier: Apache-2.0
//
// ClientDeath: the states of a client whose session is over, from the record of its death until its
// place is free. A core without I/O: it reads the registry and says what the next step is; Reaping
// (reaper.hpp) carries it out.
//
//     ClientState    state            verb → function
//
//     alive
//       │                             die: its death is journaled → Registry::client_died, by Reaping()
//       ▼
//     dead           closing          close its subscriptions → Endings::close_subscription
//       │            orphaning        orphan its publishers, with their queues repaired → Endings::orphan
//       │            unmapping        unmap its region in the daemon → Regions::unmap_client
//       │            acknowledging    acknowledge for it what it was told of, topic by topic
//       │                               → Registry::acknowledge_topic; then Endings::free_unused of what is there
//       │            forgetting       forget it: it leaves the announce sets of regions, and its doorbells go
//       │                               → EndpointManager::forget_client, Doorbells::close_client
//       ▼
//     forgotten      forgotten        free its place, when no process has its region any more
//       │                               → Endings::free_unused_client
//       ▼
//     free
//
// One that was revoked goes the same way while its process lives, and stays `forgotten` until that
// ends (ClientTermination::free_revoked). Which of these states a daemon that starts begins with
// says journal/cases.hpp: its `recover` and `finish` are the first one, its `settle` is the last
// one.
//
// Truths: from `orphaning` on no subscription of it is active or leaving; from `unmapping` on no
// publisher of it is active; from `forgetting` on no announce set of an endpoint has it. The daemon
// may die in each state: the tables have `dead`, so the next daemon begins again with `closing`,
// and finds done what was done. A daemon that dies in `forgotten` leaves nothing to repeat.
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
/// Of a topic that it knew, each place in turn.
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

  /// What is to be done next. Nothing: it is forgotten. What an earlier step said is done by now;
  /// others may have been served meanwhile, to whom what is left of the client looks as if it
  /// lived.
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
  std::vector<EndpointRef> endpoints_;  // as they were at the beginning: they go one by one
  std::size_t next_endpoint_ = 0;       // to be closed, then to be orphaned
  std::set<TopicIndex> topics_;         // of those endpoints, yet to be acknowledged
  std::vector<EndpointRef> to_free_;    // of one topic, the last one first
};

}  // namespace agnocast::daemon
