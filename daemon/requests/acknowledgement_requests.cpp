// SPDX-License-Identifier: Apache-2.0
//
// AcknowledgementRequests: see the header.

#include <daemon/requests/acknowledgement_requests.hpp>

namespace agnocast::daemon {

Result<void> AcknowledgementRequests::drained(Peer& peer, const DrainedRequest& request) {
  return endpoint_manager_.drained(*peer.session.client(), request);
}

Result<void> AcknowledgementRequests::unlinked(Peer& peer, const wire::Unlinked& statement) {
  return endpoint_manager_.unlinked(*peer.session.client(), statement);
}

Result<void> AcknowledgementRequests::blocked(Peer& peer, const wire::Blocked& range) {
  return conflicts_.add_obstacle(peer.session.identity(), *peer.session.client(), range);
}

Result<void> AcknowledgementRequests::withdrawn(Peer& peer, const wire::Withdrawn& report) {
  readers_.withdrawn(peer.session.identity(), *peer.session.client(), report);
  return {};
}

}  // namespace agnocast::daemon
