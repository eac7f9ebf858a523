// SPDX-License-Identifier: Apache-2.0
//
// WindowRequests: heap windows: those that a process asks for, and those that it brings from a
// previous incarnation.
#pragma once

#include <base/descriptors/unique_fd.hpp>
#include <base/text/log.hpp>
#include <daemon/admission/address_conflicts.hpp>
#include <daemon/admission/admission.hpp>
#include <daemon/lifecycle/endpoint_manager.hpp>
#include <daemon/lifecycle/regions.hpp>
#include <daemon/state/address_plan.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/peer_output.hpp>
#include <daemon/transport/request_reading.hpp>

#include <span>

namespace agnocast::daemon {

class WindowRequests {
 public:
  WindowRequests(const Arena& arena, Registry& registry, Regions& regions, AddressPlan& plan,
                 EndpointManager& endpoint_manager, AddressConflicts& conflicts,
                 Admission& admission, PeerOutput& output, Log& log) noexcept
      : arena_(arena),
        registry_(registry),
        regions_(regions),
        plan_(plan),
        endpoint_manager_(endpoint_manager),
        conflicts_(conflicts),
        admission_(admission),
        output_(output),
        log_(log) {}

  [[nodiscard]] Result<void> open_window(Peer& peer, const wire::WindowRequest& request);
  [[nodiscard]] Result<void> bring_window(Peer& peer, const wire::BringWindow& request,
                                          std::span<UniqueFd> fds);

 private:
  /// Carries out what bring_window() has decided, except for the answer. Errors: os_failure.
  [[nodiscard]] Result<void> take_brought(const Peer& peer, const wire::BringWindow& request,
                                          const UniqueFd& window);

  const Arena& arena_;
  Registry& registry_;
  Regions& regions_;
  AddressPlan& plan_;
  EndpointManager& endpoint_manager_;
  AddressConflicts& conflicts_;
  Admission& admission_;
  PeerOutput& output_;
  Log& log_;
};

}  // namespace agnocast::daemon
