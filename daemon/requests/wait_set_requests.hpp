// SPDX-License-Identifier: Apache-2.0
//
// WaitSetRequests: wait sets of a process, and the doorbells by which publishers wake them.
#pragma once

#include <daemon/admission/admission.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/doorbells.hpp>
#include <daemon/transport/peer_output.hpp>
#include <daemon/transport/request_reading.hpp>

namespace agnocast::daemon {

class WaitSetRequests {
 public:
  WaitSetRequests(Registry& registry, Doorbells& doorbells, Admission& admission,
                  PeerOutput& output) noexcept
      : registry_(registry), doorbells_(doorbells), admission_(admission), output_(output) {}

  [[nodiscard]] Result<void> open_wait_set(Peer& peer, const WaitSetRequest& request);

 private:
  [[nodiscard]] Result<void> admit_wait_set(ClientIndex client, const WaitSetRequest& request);

  Registry& registry_;
  Doorbells& doorbells_;
  Admission& admission_;
  PeerOutput& output_;
};

}  // namespace agnocast::daemon
