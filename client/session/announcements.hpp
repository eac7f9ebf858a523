// SPDX-License-Identifier: Apache-2.0
//
// Announcements: what the daemon says unasked of endpoints, of other processes, and of this
// process's heap: one handler for each kind of packet. Control thread only, in the order in which
// the daemon says it.
//
// Whoever is announced and is not linked here, by no endpoint of this process, is said to be
// unlinked; and whose region was never mapped is said to be unmapped, because nobody else will. An
// announcement whose descriptors were lost is said again after a new connection, so nothing is said
// of it.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <client/endpoint/endpoint_table.hpp>
#include <client/endpoint/peer_table.hpp>
#include <client/heap/heap_growth.hpp>
#include <client/session/connection.hpp>
#include <client/session/reader_look.hpp>

#include <cstddef>
#include <memory>

namespace agnocast {

class Announcements {
 public:
  Announcements(EndpointTable& endpoints, PeerTable& peers, ReaderLook& readers,
                HeapGrowth& growth) noexcept
      : endpoints_(endpoints), peers_(peers), readers_(readers), growth_(growth) {}

  /// Returns whether it was one of these. `connection`: on which it came. Allocates.
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
