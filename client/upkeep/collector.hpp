// SPDX-License-Identifier: Apache-2.0
//
// Collector: in each cycle of the control thread, scans, and removes from one session publishers
// without readers, subscriptions without links and processes without users. It reports them to the
// daemon afterwards, never before (rule RU).
#pragma once

#include <client/connection/connection.hpp>
#include <client/endpoint/endpoint_table.hpp>
#include <client/endpoint/peer_table.hpp>

namespace agnocast {

/// Control thread.
class Collector {
 public:
  Collector(EndpointTable& endpoints, PeerTable& peers) noexcept
      : endpoints_(endpoints), peers_(peers) {}

  /// Removes all that has ended, and reports it. Allocates.
  void collect(Connection& connection);
  /// Runs the scans only.
  void scan();
  /// Does the same for a session whose daemon will not come back: finds gone peers by itself, and
  /// reports nothing.
  void collect_alone();
  /// Returns whether nothing of the session is in use any more except its places of wait sets.
  bool is_unused() const noexcept { return endpoints_.is_empty() && peers_.is_empty(); }

 private:
  void collect_publishers(Connection& connection);
  void collect_subscriptions(Connection& connection);
  void collect_peers(Connection& connection);

  EndpointTable& endpoints_;
  PeerTable& peers_;
};

}  // namespace agnocast
