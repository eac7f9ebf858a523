// SPDX-License-Identifier: Apache-2.0
//
// ClientTermination: acts on the end of a connection, the end of a process and an order to revoke.
//
//   connection ended   drop (no client), or detach: the process lives, and may come back
//   process ended      drop, or reap; free the place of a revoked client
//   region gone        reap: after exec, or when the library was shut down
//   revoke             reap although the process lives; notify it, and keep watching its pidfd
//
// journal/cases.hpp decides between them; this class carries the decision out.
#pragma once

#include <base/text/log.hpp>
#include <daemon/death/reaping_queue.hpp>
#include <daemon/death/region_look.hpp>
#include <daemon/lifecycle/endpoint_manager.hpp>
#include <daemon/state/obstacles.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/descriptor_store.hpp>
#include <daemon/transport/dispatcher.hpp>

#include <cstdint>
#include <string>
#include <string_view>

namespace agnocast::daemon {

class ClientTermination {
 public:
  ClientTermination(ConnectionTable& connections, Dispatcher& dispatcher, Registry& registry,
                    DescriptorStore& store, Obstacles& obstacles, EndpointManager& endpoint_manager,
                    ReapingQueue& reaping, RegionLook& region_look, Log& log) noexcept
      : connections_(connections),
        dispatcher_(dispatcher),
        registry_(registry),
        store_(store),
        obstacles_(obstacles),
        endpoint_manager_(endpoint_manager),
        reaping_(reaping),
        region_look_(region_look),
        log_(log) {}

  /// Handles the end of a connection; the process may live.
  void disconnect(Peer& peer, std::string_view why);
  /// Handles the end of a process, or of its mappings of its region.
  void reap(Peer& peer, journal::DeathReason reason, std::string_view how);
  /// Does the same for a client that has no peer.
  void reap(ClientIndex client, journal::DeathReason reason, std::string_view how,
            std::uint64_t budget_ns = ReapingQueue::budget_ns_of_slice);
  /// Ends the session of a living process. `why` goes to it and to the log.
  void revoke(Peer& peer, const std::string& why);
  /// Sends the last packet of a revoked process, then shuts its connection down.
  void shut_down(Peer& peer);
  /// Checks whether a process without a connection has unmapped its region, and reaps it then.
  void look_whether_gone(Peer& peer);
  /// Does the same for every process without a connection.
  void look_at_detached();

 private:
  void free_revoked(ClientIndex client, journal::DeathReason reason, std::string_view how);

  ConnectionTable& connections_;
  Dispatcher& dispatcher_;
  Registry& registry_;
  DescriptorStore& store_;
  Obstacles& obstacles_;
  EndpointManager& endpoint_manager_;
  ReapingQueue& reaping_;
  RegionLook& region_look_;
  Log& log_;
};

}  // namespace agnocast::daemon
