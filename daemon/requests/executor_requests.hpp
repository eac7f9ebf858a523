// SPDX-License-Identifier: Apache-2.0
//
// ExecutorRequests: executors of a process, and the doorbells by which publishers wake them.
#pragma once

#include <daemon/admission/admission.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/doorbells.hpp>
#include <daemon/transport/peer_output.hpp>
#include <daemon/transport/requests.hpp>

namespace agnocast::daemon {

class ExecutorRequests {
 public:
  ExecutorRequests(Registry& registry, Doorbells& doorbells, Admission& admission,
                   PeerOutput& output) noexcept
      : registry_(registry), doorbells_(doorbells), admission_(admission), output_(output) {}

  [[nodiscard]] Result<void> open_executor(Peer& peer, const ExecutorRequest& request);

 private:
  [[nodiscard]] Result<void> admit_executor(ClientIndex client, const ExecutorRequest& request);

  Registry& registry_;
  Doorbells& doorbells_;
  Admission& admission_;
  PeerOutput& output_;
};

}  // namespace agnocast::daemon
