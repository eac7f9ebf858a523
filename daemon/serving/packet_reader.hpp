// SPDX-License-Identifier: Apache-2.0
//
// PacketReader: reads as many packets of one connection as its user's time slice has room for.
//
// The loop receives packets directly only from a connection that cannot carry descriptors. On
// others it peeks first, and Disposal receives a window while the connection is parked.
#pragma once

#include <daemon/death/client_termination.hpp>
#include <daemon/serving/request_scheduler.hpp>
#include <daemon/serving/request_server.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/disposal.hpp>
#include <daemon/transport/fair_scheduler.hpp>
#include <daemon/transport/peer_output.hpp>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>

namespace agnocast::daemon {

class PacketReader {
 public:
  PacketReader(ConnectionTable& connections, PeerOutput& output, Disposal& disposal,
               RequestScheduler& scheduler, ClientTermination& termination,
               RequestServer& server) noexcept
      : connections_(connections),
        output_(output),
        disposal_(disposal),
        scheduler_(scheduler),
        termination_(termination),
        server_(server) {}

  /// Serves one connection, and its process's end. Returns the number of packets; nothing: gone.
  std::optional<unsigned> serve_slice(PeerId id, const TimeSlice& slice);
  /// Returns the number of packets.
  unsigned read(PeerId id, const TimeSlice& slice);

 private:
  /// Looks at the next packet of a connection that may carry descriptors. Returns false if it must
  /// not be received here and has been handled.
  bool may_receive(Peer& peer, std::span<std::byte> buffer);
  /// Makes Disposal receive a window with its descriptor, in another thread.
  void receive_window(Peer& peer);
  void serve_window(PeerId id, std::uint64_t ticket, Disposal::Received& received);

  ConnectionTable& connections_;
  PeerOutput& output_;
  Disposal& disposal_;
  RequestScheduler& scheduler_;
  ClientTermination& termination_;
  RequestServer& server_;
  std::shared_ptr<char> here_ = std::make_shared<char>();  // expires before errands that end later
};

}  // namespace agnocast::daemon
