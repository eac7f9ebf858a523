// SPDX-License-Identifier: Apache-2.0
//
// ClientTermination: what the end of a connection, the end of a process and an order to revoke
// mean.
//
//   connection ended   drop (nobody's), or detach: the process lives, and may come back
//   process ended      drop, or reap; a revoked one: its place becomes free
//   region gone        reap: after exec, or when the library was shut down
//   revoke             reap although the process lives; the process is told, and its pidfd stays
//   watched
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

  /// The connection is over; the process may live.
  void disconnect(Peer& peer, std::string_view why);
  /// The process has ended, or has nothing of its region any more.
  void reap(Peer& peer, journal::DeathReason reason, std::string_view how);
  /// The same of a client that has no peer.
  void reap(ClientIndex client, journal::DeathReason reason, std::string_view how,
            std::uint64_t budget_ns = ReapingQueue::budget_ns_of_slice);
  /// Ends the session of a process that lives. `why` is for it and for the log.
  void revoke(Peer& peer, const std::string& why);
  /// Sends what a revoked process is to hear last, then shuts its connection.
  void say_farewell(Peer& peer);
  /// Of a process without a connection: it is reaped if it has let go.
  void look_whether_gone(Peer& peer);
  /// The same of every process without a connection.
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
