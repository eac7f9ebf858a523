// SPDX-License-Identifier: Apache-2.0
//
// HelloRequests: a process joins.
//
// If it has been here before, a thread first looks at its previous sessions; its hello is parked.
#pragma once

#include <base/text/log.hpp>
#include <daemon/admission/admission.hpp>
#include <daemon/death/client_termination.hpp>
#include <daemon/death/region_look.hpp>
#include <daemon/lifecycle/regions.hpp>
#include <daemon/serving/request_scheduler.hpp>
#include <daemon/serving/request_server.hpp>
#include <daemon/state/address_plan.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/descriptor_store.hpp>
#include <daemon/transport/peer_output.hpp>
#include <daemon/transport/request_reading.hpp>

#include <cstdint>

namespace agnocast::daemon {

/// The parts of the daemon that HelloRequests needs.
struct HelloParts {
  const Arena& arena;
  Registry& registry;
  Regions& regions;
  DescriptorStore& store;
  Admission& admission;
  ConnectionTable& connections;
  PeerOutput& output;
  RequestScheduler& scheduler;
  RegionLook& region_look;
  ClientTermination& termination;
  RequestServer& server;
  Log& log;
};

class HelloRequests {
 public:
  explicit HelloRequests(const HelloParts& parts) noexcept : of_(parts) {}

  [[nodiscard]] Result<void> hello(Peer& peer, const wire::Hello& hello);

 private:
  struct Before;
  /// Returns true when the process has been here before and must be looked at first; its hello is
  /// parked until then.
  bool look_before(Peer& peer, const wire::Hello& hello);
  void welcome_after(PeerId id, std::uint64_t ticket, const wire::Hello& hello,
                     const Before& before);
  [[nodiscard]] Result<void> welcome(Peer& peer, const wire::Hello& hello);

  HelloParts of_;
};

}  // namespace agnocast::daemon
