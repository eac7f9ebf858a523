// SPDX-License-Identifier: Apache-2.0
//
// RefusalReport: reports a refused request to the process that asked, to the log, and to people
// who ask later (Refusals).
#pragma once

#include <base/text/log.hpp>
#include <daemon/admission/admission.hpp>
#include <daemon/state/refusals.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/peer_output.hpp>
#include <daemon/transport/request_reading.hpp>

#include <cstdint>
#include <string_view>

namespace agnocast::daemon {

class RefusalReport {
 public:
  RefusalReport(Registry& registry, const Admission& admission, Refusals& refusals,
                PeerOutput& output, Log& log) noexcept
      : registry_(registry),
        admission_(admission),
        refusals_(refusals),
        output_(output),
        log_(log) {}

  /// `id`: number of the request, as its sender knows it.
  void report(Peer& peer, const Request& request, std::uint64_t id, Errc code, int os_errno,
              std::string_view why);

 private:
  void remember(const Peer& peer, const Request& request, Errc code, std::string_view why);
  void answer(Peer& peer, const Request& request, std::uint64_t id, Errc code, int os_errno,
              std::string_view text);

  Registry& registry_;
  const Admission& admission_;
  Refusals& refusals_;
  PeerOutput& output_;
  Log& log_;
};

}  // namespace agnocast::daemon
