// SPDX-License-Identifier: Apache-2.0
//
// Collector: what is over of one session, at each turn of the control thread: scans are made,
// publishers that nobody reads any more, subscriptions that have no link any more, and processes
// that nobody uses are taken out of their tables; the daemon is told afterwards, never before (rule
// RU).
#pragma once

#include <client/endpoint/endpoint_table.hpp>
#include <client/endpoint/peer_table.hpp>
#include <client/session/connection.hpp>

namespace agnocast {

/// Control thread.
class Collector {
 public:
  Collector(EndpointTable& endpoints, PeerTable& peers) noexcept
      : endpoints_(endpoints), peers_(peers) {}

  /// Allocates.
  void collect(Connection& connection);
  /// The scans alone.
  void scan();
  /// The same of a session whose daemon will not come back: nobody says who is gone, and nobody is
  /// told.
  void collect_alone();
  /// Nothing of the session is used any more but its executor places.
  bool is_unused() const noexcept { return endpoints_.is_empty() && peers_.is_empty(); }

 private:
  void collect_publishers(Connection& connection);
  void collect_subscriptions(Connection& connection);
  void collect_peers(Connection& connection);

  EndpointTable& endpoints_;
  PeerTable& peers_;
};

}  // namespace agnocast
