// SPDX-License-Identifier: Apache-2.0
//
// Creations: a session's requests to its daemon for new publishers, subscriptions and wait sets.
// The caller waits for the answer. The control thread handles it, so an endpoint is in its table
// before the daemon can announce anything to it.
//
// If the answer comes after the caller has given up, the endpoint is known to the daemon only: it
// is unclaimed (Departures).
#pragma once

#include <agnocast/message_type.hpp>
#include <agnocast/result.hpp>
#include <client/connection/registration.hpp>
#include <client/endpoint/endpoint_table.hpp>
#include <client/session/endpoint_request.hpp>
#include <client/upkeep/departures.hpp>

#include <cstdint>
#include <memory>

namespace agnocast {

class Context;

/// Any thread but the control thread.
class Creations {
 public:
  /// `session`: the owner of the endpoints.
  Creations(Context* session, Registration& registration, EndpointTable& endpoints,
            Departures& departures) noexcept
      : session_(session),
        registration_(registration),
        endpoints_(endpoints),
        departures_(departures) {}

  /// Creates a publisher; the heap must be open. `make_room`: see PublisherEndpoint::Identity.
  /// Errors: those of Context::create_publisher.
  [[nodiscard]] Result<std::shared_ptr<PublisherEndpoint>> make_publisher(
      const EndpointRequest& request, const detail::MessageEnd& end_message,
      const Continued& continued, bool (*make_room)() noexcept);
  /// Creates a subscription; the wait set must have a place in the session. Errors: those of
  /// Context::create_subscription.
  [[nodiscard]] Result<std::shared_ptr<SubscriptionEndpoint>> make_subscription(
      const EndpointRequest& request, const std::shared_ptr<WaitSet>& wait_set,
      const Continued& continued);
  /// Returns a place with the doorbells of a wait set and its sleep word. `again`: the daemon may
  /// have opened it before.
  [[nodiscard]] Result<std::unique_ptr<WaitSet::Place>> open_wait_set(std::uint64_t wait_set,
                                                                      bool again);

 private:
  using Kind = abi::wire::Kind;
  std::uint64_t persistent_id_of(const Continued& continued, const abi::wire::EndpointCreated& made,
                                 Kind kind) const noexcept;
  Result<void> adopt_late(Kind kind, Incoming& packet);

  Context* const session_;
  Registration& registration_;
  EndpointTable& endpoints_;
  Departures& departures_;
};

}  // namespace agnocast
