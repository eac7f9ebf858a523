// SPDX-License-Identifier: Apache-2.0
//
// Creations: what a session asks its daemon to make for this process: publishers, subscriptions,
// executors. Whoever asks waits for the answer; what it means is done in the control thread, so an
// endpoint is in its table before the daemon can announce anything to it.
//
// An answer that comes when nobody waits any more is an endpoint that only the daemon knows:
// unclaimed (Departures).
#pragma once

#include <agnocast/message_type.hpp>
#include <agnocast/result.hpp>
#include <client/endpoint/endpoint_table.hpp>
#include <client/session/departures.hpp>
#include <client/session/endpoint_request.hpp>
#include <client/session/registration.hpp>

#include <cstdint>
#include <memory>

namespace agnocast {

class Context;

/// Any thread but the control thread.
class Creations {
 public:
  /// `session`: whose endpoints they are.
  Creations(Context* session, Registration& registration, EndpointTable& endpoints,
            Departures& departures) noexcept
      : session_(session),
        registration_(registration),
        endpoints_(endpoints),
        departures_(departures) {}

  /// The heap is open. `make_room`: see PublisherEndpoint::Identity. Errors: those of
  /// Context::create_publisher.
  [[nodiscard]] Result<std::shared_ptr<PublisherEndpoint>> make_publisher(
      const EndpointRequest& request, const detail::MessageEnd& end_message,
      const Continued& continued, bool (*make_room)() noexcept);
  /// The wait set has a place in this session. Errors: those of Context::create_subscription.
  [[nodiscard]] Result<std::shared_ptr<SubscriptionEndpoint>> make_subscription(
      const EndpointRequest& request, const std::shared_ptr<WaitSet>& wait_set,
      const Continued& continued);
  /// The doorbells of an executor, with its sleep word. `again`: the daemon may have opened it
  /// before.
  [[nodiscard]] Result<std::unique_ptr<WaitSet::Place>> open_executor(std::uint64_t executor,
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
