// SPDX-License-Identifier: Apache-2.0
//
// AcknowledgementRequests: reports of a process about what was announced to it: it has read a
// publisher to its end, unmapped something, cannot map a window, or withdraws from a reader.
#pragma once

#include <daemon/admission/address_conflicts.hpp>
#include <daemon/lifecycle/endpoint_manager.hpp>
#include <daemon/requests/reader_reports.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/request_reading.hpp>

namespace agnocast::daemon {

class AcknowledgementRequests {
 public:
  AcknowledgementRequests(EndpointManager& endpoint_manager, AddressConflicts& conflicts,
                          ReaderReports& readers) noexcept
      : endpoint_manager_(endpoint_manager), conflicts_(conflicts), readers_(readers) {}

  [[nodiscard]] Result<void> drained(Peer& peer, const DrainedRequest& request);
  [[nodiscard]] Result<void> unlinked(Peer& peer, const wire::Unlinked& statement);
  [[nodiscard]] Result<void> blocked(Peer& peer, const wire::Blocked& range);
  [[nodiscard]] Result<void> withdrawn(Peer& peer, const wire::Withdrawn& report);

 private:
  EndpointManager& endpoint_manager_;
  AddressConflicts& conflicts_;
  ReaderReports& readers_;
};

}  // namespace agnocast::daemon
