// SPDX-License-Identifier: Apache-2.0
//
// Announcing: decides which process is notified of which endpoint: when an endpoint is created,
// when a process comes back, when doorbells change. A core without I/O, as endings.hpp.
//
// A process that is to get a publisher's messages is recorded in its announce set before anything
// relies on that, whatever happens to either afterwards. If the daemon dies between the record of
// a creation and those of the announcements, the client asks the next daemon again, which makes up
// for the rest: so the records precede every answer.
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

  /// Returns the answer to the request that created an endpoint, and all announcements of it.
  Effects created(const EndpointRef& ref, std::uint64_t request) const;
  /// Returns the same answer once more; only the requesting process is notified of its peers.
  Effects answered_again(const EndpointRef& ref, std::uint64_t request) const;
  /// Announces to an endpoint's own process the peers of the endpoint.
  Effects to_owner(const EndpointRef& ref) const;
  /// Announces a subscription once more to each of its publishers.
  Effects to_publishers_of(const EndpointRef& subscription) const;
  /// Names its own endpoint to a process that has come back.
  Effects own(const EndpointRef& ref) const;
  /// Notifies that process also of what is over in a topic and was never acknowledged.
  Effects what_is_over(ClientIndex client, TopicIndex topic) const;

 private:
  Effects records_of_members(const EndpointRef& ref) const;
  effect::Send answer(const EndpointRef& ref, std::uint64_t request) const;
  /// Returns notices about endpoints of the topic that do not match this one, for its own process
  /// or for both sides.
  Effects mismatches(const EndpointRef& ref, bool to_both) const;
  bool is_to_know(const PublisherRecord& own, const SubscriptionRecord& other) const;
  /// Returns whether the process has a publisher that still looks at this subscription.
  bool is_looked_at(TopicIndex topic, const SubscriptionRecord& subscription, ClientIndex by) const;

  const Registry& registry_;
  const Endings& endings_;
};

}  // namespace agnocast::daemon
