// SPDX-License-Identifier: Apache-2.0
//
// Endings: decides what the end of an endpoint means to others, and when its place, its topic and
// its process may be used again (rule RU). A core without I/O: it reads the registry and returns
// effects (effects.hpp).
//
//                 orphan                       free_unused: nobody has it          drained
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

/// What is over, by the user whose it was and generation: a process that was told of it and holds
/// nothing of it is to unmap it now.
using GivenUp = std::map<std::uint32_t, std::map<std::uint64_t, EndpointRef>>;

class Endings {
 public:
  explicit Endings(const Registry& registry) noexcept : registry_(registry) {}

  /// Nobody publishes there any more: board, then every subscription is rung, and everybody who
  /// knows it is told.
  Effects orphan(const EndpointRef& ref, std::uint64_t final_head, journal::LeaveCause cause) const;
  /// The process of this subscription is without a session.
  Effects close_subscription(const EndpointRef& ref) const;
  /// Everybody who was told of a subscription that is over is to unmap it.
  Effects ask_to_unmap(const EndpointRef& subscription) const;
  /// The publishers that know a subscription are to look at it once more.
  Effects kick_publishers_of(const EndpointRef& subscription) const;
  Effects acknowledge(const EndpointRef& ref, ClientIndex by) const;

  /// Frees the endpoint if it is over and nobody has it any more, and with it its topic and its
  /// process.
  Effects free_unused(const EndpointRef& ref);
  Effects free_unused_topic(TopicIndex topic) const;
  Effects free_unused_client(ClientIndex client) const;
  Effects free_unused_clients() const;

  /// Of the publishers, and of the subscriptions, of a topic that are over, the oldest are given up
  /// when they are too many.
  Effects give_up_orphans(TopicIndex topic);
  Effects give_up_subscriptions(TopicIndex topic);
  /// Of the processes that are gone and of which others have something, gives up the oldest of the
  /// user who has most, when they are too many.
  Effects give_up_gone();
  const GivenUp& given_up() const noexcept { return given_up_; }

  /// What a process hears of a publisher that is gone.
  wire::Orphaned orphaned(const EndpointRef& ref) const;
  /// A refusal for lack of places, and who keeps publishers there that are gone (of that user).
  tl::unexpected<Failure> explain_full(TopicIndex topic, const Failure& why,
                                       std::optional<std::uint32_t> uid) const;

  // --- for a daemon that goes on
  /// A process that has drained its last endpoint that met another one has unmapped that one too.
  /// Its daemon may have died before it said so of each.
  Effects owed_acknowledgements(Kind kind, TopicIndex topic) const;
  /// Every endpoint of a topic is looked at, and the topic itself.
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
