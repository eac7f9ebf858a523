// SPDX-License-Identifier: Apache-2.0
//
// PacketReader: reads the packets of one connection, as many as its user's time slice has room for.
//
// A packet that brings descriptors is received in the loop only if its connection cannot carry any;
// else the packet is looked at first, and a window is received by Disposal while the connection is
// parked.
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

  /// Serves one connection, and the end of its process. Returns how many packets there were;
  /// nothing: it is gone.
  std::optional<unsigned> serve_slice(PeerId id, const TimeSlice& slice);
  /// Returns how many packets there were.
  unsigned read(PeerId id, const TimeSlice& slice);

 private:
  /// Looks at the next packet of a connection that descriptors may have come into. False: it is not
  /// to be received here, and has been dealt with.
  bool may_receive(Peer& peer, std::span<std::byte> buffer);
  /// A window comes with a descriptor, which is received elsewhere.
  void receive_window(Peer& peer);
  void serve_window(PeerId id, std::uint64_t ticket, Disposal::Received& received);

  ConnectionTable& connections_;
  PeerOutput& output_;
  Disposal& disposal_;
  RequestScheduler& scheduler_;
  ClientTermination& termination_;
  RequestServer& server_;
  std::shared_ptr<char> here_ = std::make_shared<char>();  // for errands that end later
};

}  // namespace agnocast::daemon
