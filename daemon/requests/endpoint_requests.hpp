// SPDX-License-Identifier: Apache-2.0
//
// EndpointRequests: processes create publishers and subscriptions, and let them leave.
#pragma once

#include <base/text/log.hpp>
#include <daemon/admission/admission.hpp>
#include <daemon/admission/refusal_report.hpp>
#include <daemon/config/config.hpp>
#include <daemon/lifecycle/endpoint_manager.hpp>
#include <daemon/lifecycle/regions.hpp>
#include <daemon/requests/reader_reports.hpp>
#include <daemon/serving/request_scheduler.hpp>
#include <daemon/serving/request_server.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/request_reading.hpp>

#include <cstdint>
#include <deque>
#include <memory>

namespace agnocast::daemon {

class EndpointRequests {
 public:
  EndpointRequests(const Config& config, Registry& registry, Regions& regions,
                   EndpointManager& endpoint_manager, Admission& admission,
                   RequestScheduler& scheduler, RequestServer& server, RefusalReport& refusals,
                   ReaderReports& readers, Log& log) noexcept
      : config_(config),
        registry_(registry),
        regions_(regions),
        endpoint_manager_(endpoint_manager),
        admission_(admission),
        scheduler_(scheduler),
        server_(server),
        refusals_(refusals),
        readers_(readers),
        log_(log) {}

  [[nodiscard]] Result<void> create(Peer& peer, const CreateRequest& request);
  [[nodiscard]] Result<void> leave(Peer& peer, const LeaveRequest& request);
  /// Refuses creations whose memory was not prepared in time.
  void refuse_uncleared(std::uint64_t now);
  /// Returns whether refuse_uncleared() is to be called now and then.
  bool has_uncleared() const noexcept { return !uncleared_.empty(); }

 private:
  /// A creation whose memory is being prepared.
  struct Uncleared {
    PeerId id = 0;
    std::uint64_t ticket = 0, request = 0, until_ms = 0;
  };
  // Takes microseconds, unless its process keeps the file locked, or others keep all threads busy.
  static constexpr std::uint64_t clearing_ms = 10'000;

  /// Returns true if memory must be prepared first; the request is parked until then.
  [[nodiscard]] Result<bool> clear_before(Peer& peer, const CreateRequest& request);

  const Config& config_;
  Registry& registry_;
  Regions& regions_;
  EndpointManager& endpoint_manager_;
  Admission& admission_;
  RequestScheduler& scheduler_;
  RequestServer& server_;
  RefusalReport& refusals_;
  ReaderReports& readers_;
  Log& log_;
  std::shared_ptr<char> here_ = std::make_shared<char>();  // expires before errands that end later
  std::deque<Uncleared> uncleared_;
};

}  // namespace agnocast::daemon
