// SPDX-License-Identifier: Apache-2.0
//
// Announcing: decides which process is told of which endpoint: when one is created, when a process
// comes back, when doorbells are others now. A core without I/O, as endings.hpp.
//
// A process that is to get a publisher's messages is recorded in its announce set before anybody
// relies on it, whatever becomes of both afterwards. A daemon that dies between the record of a
// creation and those of the announcements leaves the rest to the next one, which is asked again: so
// every answer is preceded by the records.
#pragma once

#include <daemon/lifecycle/effects.hpp>
#include <daemon/lifecycle/endings.hpp>
#include <daemon/state/registry.hpp>

#include <cstdint>

namespace agnocast::daemon {

class Announcing {
 public:
  Announcing(const Registry& registry, const Endings& endings) noexcept
      : registry_(registry), endings_(endings) {}

  /// The answer to the request that created an endpoint, and everybody who hears of it.
  Effects created(const EndpointRef& ref, std::uint64_t request) const;
  /// The same request once more: its process alone hears of what is there.
  Effects answered_again(const EndpointRef& ref, std::uint64_t request) const;
  /// An endpoint's own process is told whom it is connected with.
  Effects to_owner(const EndpointRef& ref) const;
  /// Every publisher of a subscription is told of it once more.
  Effects to_publishers_of(const EndpointRef& subscription) const;
  /// A process that has come back is told of its own endpoint.
  Effects own(const EndpointRef& ref) const;
  /// And of what is over in a topic and was never acknowledged.
  Effects what_is_over(ClientIndex client, TopicIndex topic) const;

 private:
  Effects records_of_members(const EndpointRef& ref) const;
  effect::Send answer(const EndpointRef& ref, std::uint64_t request) const;
  /// Notices about endpoints of the topic that do not match this one; to its own process alone, or
  /// to both.
  Effects mismatches(const EndpointRef& ref, bool to_both) const;
  bool is_to_know(const PublisherRecord& own, const SubscriptionRecord& other) const;
  /// Has a process a publisher that still looks at this subscription?
  bool is_looked_at(TopicIndex topic, const SubscriptionRecord& subscription, ClientIndex by) const;

  const Registry& registry_;
  const Endings& endings_;
};

}  // namespace agnocast::daemon
