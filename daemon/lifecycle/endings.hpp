// SPDX-License-Identifier: Apache-2.0
//
// Endings: decides what the end of an endpoint means to others, and when its place, its topic and
// its process may be used again (rule RU). A core without I/O: it reads the registry and returns
// effects (effects.hpp).
//
//                 orphan                       free_unused: unmapped by all        drained
//   publisher     active ─────────▶ orphan ──────────────────────────────▶ over ──────────▶ free
//                                       ╰─── free_unused: its process is dead ────────────────▲
//
//                 leave                 drained                 free_unused
//   subscription  active ─────▶ leaving ─────────▶ over ─────────────────────▶ free
//                     ╰────────────┴── close ────▶ dead ── free_unused ─────────▲
//
// The end of a process is the end of each of its endpoints: death/client_death.hpp.
#pragma once

#include <daemon/lifecycle/effects.hpp>
#include <daemon/state/registry.hpp>

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <utility>
#include <vector>

namespace agnocast::daemon {

/// Endpoints that are over, by their user and generation. A process that was notified of one and
/// holds nothing of it must unmap it now.
using GivenUp = std::map<std::uint32_t, std::map<std::uint64_t, EndpointRef>>;

class Endings {
 public:
  explicit Endings(const Registry& registry) noexcept : registry_(registry) {}

  /// Ends a publisher: changes the board, rings subscriptions, notifies each process that knows
  /// it.
  Effects orphan(const EndpointRef& ref, std::uint64_t final_head, journal::LeaveCause cause) const;
  /// Ends a subscription whose process is without a session.
  Effects close_subscription(const EndpointRef& ref) const;
  /// Asks each process that was notified of a subscription that is over to unmap it.
  Effects ask_to_unmap(const EndpointRef& subscription) const;
  /// Asks the publishers that know a subscription to look at it once more.
  Effects kick_publishers_of(const EndpointRef& subscription) const;
  Effects acknowledge(const EndpointRef& ref, ClientIndex by) const;

  /// Frees the endpoint if it is over and unmapped everywhere, then its topic and process.
  Effects free_unused(const EndpointRef& ref);
  Effects free_unused_topic(TopicIndex topic) const;
  Effects free_unused_client(ClientIndex client) const;
  Effects free_unused_clients() const;

  /// When too many publishers, or subscriptions, of a topic are over: give up the oldest.
  Effects give_up_orphans(TopicIndex topic);
  Effects give_up_subscriptions(TopicIndex topic);
  /// When there are too many processes that are gone but still mapped by others, gives up the
  /// oldest of the user with most of them.
  Effects give_up_gone();
  const GivenUp& given_up() const noexcept { return given_up_; }

  /// Returns the notification that a publisher is gone.
  wire::Orphaned orphaned(const EndpointRef& ref) const;
  /// Returns a refusal for lack of places that names the process which keeps gone publishers there
  /// (of that user).
  tl::unexpected<Failure> explain_full(TopicIndex topic, const Failure& why,
                                       std::optional<std::uint32_t> uid) const;

  // --- for a daemon that continues
  /// Returns acknowledgements that the previous daemon may have died before recording: a process
  /// that has drained its last endpoint that met another one has unmapped that one too.
  Effects owed_acknowledgements(Kind kind, TopicIndex topic) const;
  /// Checks every endpoint of a topic, and the topic itself, for places to free.
  Effects free_all_unused(TopicIndex topic) const;

 private:
  using Aged = std::vector<std::pair<std::uint64_t, EndpointRef>>;  // by generation

  wire::Orphaned orphaned(const EndpointRef& ref, std::uint64_t final_head) const;
  effect::Send kick(const EndpointRef& publisher) const;
  Effects give_up(const EndpointRef& ref);
  Effects give_up_oldest(Aged& over, std::size_t kept);
  Effects give_up_all_of(ClientIndex client);
  std::uint32_t user_of(const EndpointRef& ref) const;
  bool is_given_up(const EndpointRef& ref) const;
  void forget_given_up(const EndpointRef& ref);

  const Registry& registry_;
  GivenUp given_up_;
};

}  // namespace agnocast::daemon
