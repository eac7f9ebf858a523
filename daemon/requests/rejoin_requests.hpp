// SPDX-License-Identifier: Apache-2.0
//
// RejoinRequests: a process that has lost its connection takes its place again.
#pragma once

#include <base/text/log.hpp>
#include <daemon/admission/access_control.hpp>
#include <daemon/admission/address_conflicts.hpp>
#include <daemon/death/client_termination.hpp>
#include <daemon/death/unmap_watch.hpp>
#include <daemon/lifecycle/endpoint_manager.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/doorbells.hpp>
#include <daemon/transport/peer_output.hpp>
#include <daemon/transport/request_reading.hpp>

namespace agnocast::daemon {

/// The parts of the daemon that RejoinRequests needs.
struct RejoinParts {
  Registry& registry;
  Doorbells& doorbells;
  EndpointManager& endpoint_manager;
  AccessControl& access;
  AddressConflicts& conflicts;
  UnmapWatch& unmap_watch;
  ConnectionTable& connections;
  PeerOutput& output;
  ClientTermination& termination;
  Log& log;
};

class RejoinRequests {
 public:
  explicit RejoinRequests(const RejoinParts& parts) noexcept : of_(parts) {}

  [[nodiscard]] Result<void> rejoin(Peer& peer, const wire::Rejoin& request);

 private:
  [[nodiscard]] Result<Peer*> lost_peer(const Peer& peer, const wire::Rejoin& request);
  /// Replaces doorbells that were lost.
  void renew_doorbells(Peer& peer);

  RejoinParts of_;
};

}  // namespace agnocast::daemon
