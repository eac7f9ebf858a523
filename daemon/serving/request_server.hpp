// SPDX-License-Identifier: Apache-2.0
//
// RequestServer: from a packet to an answer. Decodes it, calls its handler, reports a refusal.
//
// A request is a parsed packet: its values are bounded, but the handler has to check them against
// quotas, access rules and the tables. Its changes are recorded before it is answered.
// docs/control-plane.md.
#pragma once

#include <daemon/admission/address_conflicts.hpp>
#include <daemon/admission/admission.hpp>
#include <daemon/admission/refusal_report.hpp>
#include <daemon/death/client_termination.hpp>
#include <daemon/serving/request_table.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/request_reading.hpp>

#include <cstddef>
#include <cstdint>
#include <span>

namespace agnocast::daemon {

class RequestServer {
 public:
  RequestServer(Admission& admission, AddressConflicts& conflicts, RefusalReport& refusals,
                ClientTermination& termination);

  /// To be filled before the first request.
  RequestTable& handlers() noexcept { return handlers_; }
  /// `fds`: descriptors that came with the packet. Refuses the packet when there is no memory.
  void serve_packet(Peer& peer, std::span<const std::byte> bytes, const Envelope& envelope,
                    std::span<UniqueFd> fds);
  /// Serves a request that was parked.
  void serve_again(Peer& peer, const Request& request);

 private:
  template <class Serve>
  void serve_or_refuse(Peer& peer, std::uint64_t id, Serve serve_it);
  void serve(Peer& peer, const Request& request, std::span<UniqueFd> fds);
  [[nodiscard]] Result<void> reject(Peer& peer, const Rejected& rejected);

  Admission& admission_;
  AddressConflicts& conflicts_;
  RefusalReport& refusals_;
  ClientTermination& termination_;
  RequestTable handlers_;
};

}  // namespace agnocast::daemon
