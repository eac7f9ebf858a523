// SPDX-License-Identifier: Apache-2.0
//
// RequestScheduler: see the header.

#include <daemon/serving/request_scheduler.hpp>

#include <base/clock.hpp>

#include <sys/epoll.h>

#include <utility>

namespace agnocast::daemon {

Dispatcher::Handler RequestScheduler::event_handler(PeerId id, bool ended) {
  return [this, id, ended](std::uint32_t) { wait_for_slice(id, ended); };
}

void RequestScheduler::serve(const Serve& serve) { users_.serve(serve, monotonic_ns); }

void RequestScheduler::wait_for_slice(PeerId id, bool ended) {
  Peer* const found = connections_.find(id);
  if (found == nullptr) return;
  Peer& peer = *found;
  peer.ended = peer.ended || ended;
  if (!std::exchange(peer.waits, true)) users_.wait(peer.session.identity().uid, id);
}

void RequestScheduler::park(Peer& peer, std::uint64_t ticket) {
  peer.parked = ticket;
  dispatcher_.remove(peer.connection);
  peer.connection = 0;
}

Peer* RequestScheduler::unpark(PeerId id, std::uint64_t ticket) {
  Peer* const found = connections_.find(id);
  if (found == nullptr || found->parked != ticket) return nullptr;
  Peer& peer = *found;
  peer.parked = 0;
  if (peer.session.closed()) return nullptr;
  const auto token = dispatcher_.add(
      peer.session.socket().fd(),
      peer.wants_writable || peer.revoked ? EPOLLIN | EPOLLOUT : EPOLLIN, event_handler(id, false));
  if (!token) {
    termination_.disconnect(peer, token.error().what);
    return nullptr;
  }
  peer.connection = *token;
  return peer.revoked ? nullptr : &peer;
}

}  // namespace agnocast::daemon
