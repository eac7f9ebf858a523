// SPDX-License-Identifier: Apache-2.0
//
// ObserverRequests: requests of processes that only look (agnocast-ctl). They have no place in the
// tables.
#pragma once

#include <base/text/log.hpp>
#include <daemon/admission/admission.hpp>
#include <daemon/config/access.hpp>
#include <daemon/death/client_termination.hpp>
#include <daemon/lifecycle/regions.hpp>
#include <daemon/observers/observer_answers.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/peer_output.hpp>

#include <vector>

namespace agnocast::daemon {

class ObserverRequests {
 public:
  ObserverRequests(const std::vector<AccessRule>& rules, const Registry& registry,
                   const Regions& regions, Admission& admission, ConnectionTable& connections,
                   PeerOutput& output, ClientTermination& termination, ObserverAnswers& answers,
                   Log& log) noexcept
      : rules_(rules),
        registry_(registry),
        regions_(regions),
        admission_(admission),
        connections_(connections),
        output_(output),
        termination_(termination),
        answers_(answers),
        log_(log) {}

  [[nodiscard]] Result<void> observe(Peer& peer, const wire::Observe& request);
  [[nodiscard]] Result<void> dump(Peer& peer, const wire::Dump& request);
  [[nodiscard]] Result<void> read_journal(Peer& peer, const wire::ReadJournal& request);
  [[nodiscard]] Result<void> revoke(Peer& peer, const wire::Revoke& request);
  [[nodiscard]] Result<void> set_log_level(Peer& peer, const wire::SetLogLevel& request);
  [[nodiscard]] Result<void> ask_access(Peer& peer, const wire::AskAccess& request);

 private:
  const std::vector<AccessRule>& rules_;
  const Registry& registry_;
  const Regions& regions_;
  Admission& admission_;
  ConnectionTable& connections_;
  PeerOutput& output_;
  ClientTermination& termination_;
  ObserverAnswers& answers_;
  Log& log_;
};

}  // namespace agnocast::daemon
