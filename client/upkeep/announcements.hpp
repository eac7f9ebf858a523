// SPDX-License-Identifier: Apache-2.0
//
// Announcements: handles the packets that the daemon sends unasked about endpoints, other processes
// and this process's heap: one handler for each opcode. They run in the control thread, in the
// order in which the daemon sent the packets.
//
// The client answers `unlinked` for an announced endpoint that no endpoint of this process links
// to, and for a region that it never mapped: no later step would report either. If the descriptors
// of an announcement were lost, the daemon announces it again on the next connection, so the client
// reports nothing.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <client/connection/connection.hpp>
#include <client/endpoint/endpoint_table.hpp>
#include <client/endpoint/peer_table.hpp>
#include <client/heap/heap_growth.hpp>
#include <client/upkeep/reader_look.hpp>

#include <cstddef>
#include <memory>

namespace agnocast {

class Announcements {
 public:
  Announcements(EndpointTable& endpoints, PeerTable& peers, ReaderLook& readers,
                HeapGrowth& growth) noexcept
      : endpoints_(endpoints), peers_(peers), readers_(readers), growth_(growth) {}

  /// Returns whether the packet was one of these. `connection`: the one that it came on. Allocates.
  bool handle(Connection& connection, Incoming& packet);

 private:
  struct Handler;
  void on_announce(Connection& connection, Incoming& packet);
  void on_window(Connection& connection, Incoming& packet);
  void on_forget(Connection& connection, Incoming& packet);
  void on_orphaned(Connection& connection, Incoming& packet);
  void on_kick(Connection& connection, Incoming& packet);
  void on_notice(Connection& connection, Incoming& packet);
  void on_move_heap(Connection& connection, Incoming& packet);
  bool link_publisher(const abi::wire::Announcement& announcement, std::shared_ptr<Peer> peer);
  bool attach_subscription(const abi::wire::Announcement& announcement,
                           const std::shared_ptr<Peer>& peer, Incoming& packet, std::size_t used);
  bool is_in_use(const abi::wire::Announcement& announcement) const;

  EndpointTable& endpoints_;
  PeerTable& peers_;
  ReaderLook& readers_;
  HeapGrowth& growth_;
};

}  // namespace agnocast
