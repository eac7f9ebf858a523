// SPDX-License-Identifier: Apache-2.0
//
// Windows that a process brings from a previous incarnation: see the header.

#include <daemon/transport/brought_windows.hpp>

#include <base/clock.hpp>
#include <base/sockets/packet_socket.hpp>

#include <utility>

namespace agnocast::daemon {

void expect_windows(Peer& peer) {
  peer.brings_windows = true;
  peer.session.set_may_carry(true);
  accept_descriptors(peer.session.socket().fd());
}

void expect_no_windows(Peer& peer) {
  if (!std::exchange(peer.brings_windows, false)) return;
  refuse_descriptors(peer.session.socket().fd());
  peer.refuses_since_ms = monotonic_ms();
}

}  // namespace agnocast::daemon
