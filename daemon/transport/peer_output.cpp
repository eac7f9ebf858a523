// SPDX-License-Identifier: Apache-2.0
//
// PeerOutput: see the header.

#include <daemon/transport/peer_output.hpp>

#include <base/clock.hpp>
#include <daemon/state/memory_reserve.hpp>
#include <daemon/state/steps.hpp>

#include <sys/epoll.h>
#include <sys/socket.h>

#include <new>
#include <string>
#include <utility>

namespace agnocast::daemon {

void PeerOutput::reply(Peer& peer, Outgoing packet) {
  AGNOCAST_CRASH_POINT(B_send);
  const bool waiting = peer.session.has_output();
  packet.since_ms = monotonic_ms();
  try {
    const MemoryReserve::MayFail may_fail;
    peer.session.push(std::move(packet));
  } catch (const std::bad_alloc&) {
    // It comes back and is notified of everything again.
    const MemoryReserve::MustNotFail ends;
    end(peer, no_memory_text);
    return;
  }
  // While the queue waits for the socket, another try gains nothing.
  if (!waiting || peer.session.queued_count() > Session::queue_count_max) flush(peer);
  if (peer.session.is_over()) end_longest(peer.session.identity().uid);
  AGNOCAST_CRASH_POINT(B_sent);
}

void PeerOutput::reply(Peer& peer, std::span<const std::byte> packet, std::vector<SharedFd> fds) {
  reply(peer, Outgoing{{packet.begin(), packet.end()}, std::move(fds), {}});
}

void PeerOutput::flush(Peer& peer) {
  const MemoryReserve::MustNotFail completes;  // a packet's own descriptors are made only once
  if (before_flush_) before_flush_();
  switch (peer.session.flush()) {
    case Session::Flushed::all:
      if (peer.wants_writable) dispatcher_.change(peer.connection, EPOLLIN);
      peer.wants_writable = false;
      break;
    case Session::Flushed::blocked:
      if (!peer.wants_writable) dispatcher_.change(peer.connection, EPOLLIN | EPOLLOUT);
      peer.wants_writable = true;
      break;
    case Session::Flushed::later:
      flush_later_ = true;
      break;
    case Session::Flushed::gone:
      peer.session.drop_output();
      break;
    case Session::Flushed::over:
      end(peer, "the process does not read");
      break;
  }
}

void PeerOutput::go_on_flushing() {
  if (!std::exchange(flush_later_, false)) return;
  for (auto& [id, peer] : connections_.all()) {
    if (!peer->session.closed() && !peer->revoked && peer->session.has_output()) flush(*peer);
  }
}

// Not disconnected: the caller may be in the middle of an announcement. The connection is shut
// down, and the loop reads its end like any other.
void PeerOutput::end(Peer& peer, std::string_view why) {
  const std::uint32_t uid = peer.session.identity().uid;
  log_.write_limited("output uid=" + std::to_string(uid), LogLevel::warning, "connection ended",
                     {{"pid", peer.session.identity().pid},
                      {"uid", uid},
                      {"queued", peer.session.queued_count()},
                      {"bytes", peer.session.queued_bytes()},
                      {"waited_ms", peer.session.waits_ms(monotonic_ms())},
                      {"why", why}});
  ::shutdown(peer.session.socket().fd(), SHUT_RDWR);
  peer.session.drop_output();
}

// The connection with the longest queue of this user reads least.
void PeerOutput::end_longest(std::uint32_t uid) {
  Peer* most = nullptr;
  for (const auto& [id, peer] : connections_.all()) {
    if (peer->session.identity().uid == uid && !peer->session.closed() &&
        (most == nullptr || peer->session.queued_bytes() > most->session.queued_bytes()))
      most = peer.get();
  }
  if (most != nullptr)
    end(*most, "the processes of its user do not read, this one least: [quota] queued_bytes is " +
                   std::to_string(limits_.bytes_of_user));
}

void PeerOutput::end_old(std::uint64_t now) {
  if (!limits_.seconds) return;
  const std::uint64_t seconds = *limits_.seconds;
  for (const auto& [id, peer] : connections_.all()) {
    // A revoked process only has its last packet queued, for whenever it reads again.
    if (!peer->session.closed() && !peer->revoked && peer->session.waits_ms(now) > seconds * 1000)
      end(*peer, "the process does not read: [quota] queued_seconds is " + std::to_string(seconds));
  }
}

Session* PeerOutput::session_of(ClientIndex client) {
  Peer* const peer = connections_.of_client(client);
  return peer == nullptr || peer->session.closed() ? nullptr : &peer->session;
}

std::uint64_t PeerOutput::user_namespace_of(ClientIndex client) {
  const Peer* const peer = connections_.of_client(client);
  return peer == nullptr ? 0 : peer->session.user_namespace;
}

void PeerOutput::send(ClientIndex client, Outgoing packet) {
  Peer* const peer = connections_.of_client(client);
  if (peer == nullptr || peer->session.closed()) return;
  reply(*peer, std::move(packet));
}

void PeerOutput::begin_anew(ClientIndex client, std::string_view why) {
  Peer* const peer = connections_.of_client(client);
  if (peer != nullptr && !peer->session.closed()) end(*peer, why);
}

}  // namespace agnocast::daemon
