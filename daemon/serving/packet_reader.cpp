// SPDX-License-Identifier: Apache-2.0
//
// PacketReader: see the header.

#include <daemon/serving/packet_reader.hpp>

#include <agnocast/abi/wire.hpp>
#include <base/clock.hpp>
#include <daemon/state/steps.hpp>

#include <fcntl.h>

#include <array>
#include <cstring>
#include <utility>

namespace agnocast::daemon {

using journal::DeathReason;

// The dispatcher reports a connection with more packets again; it waits behind its user's others.
std::optional<unsigned> PacketReader::serve_slice(PeerId id, const TimeSlice& slice) {
  Peer* const found = connections_.find(id);
  if (found == nullptr) return std::nullopt;
  found->waits = false;
  const bool ended = found->ended;
  // At most one full slice: another process may hold the connection and send for ever.
  const unsigned count = read(id, ended ? TimeSlice() : slice);
  if (Peer* const still = connections_.find(id); ended && still != nullptr)
    termination_.reap(*still, DeathReason::died, "process ended");
  return count;
}

unsigned PacketReader::read(PeerId id, const TimeSlice& slice) {
  std::array<std::byte, wire::packet_bytes_max> buffer;
  for (unsigned read_count = 0; read_count < slice.packets_left; ++read_count) {
    if (read_count > 0 && monotonic_ns() >= slice.until_ns) return read_count;
    Peer* const found = connections_.find(id);
    if (found == nullptr || found->session.closed()) return read_count;
    Peer& peer = *found;
    if (peer.revoked) {
      termination_.shut_down(peer);
      return read_count;
    }
    if (peer.parked != 0) return read_count;
    const bool observes = peer.session.role() == Role::observer;
    if (observes && read_count > 0) return read_count;  // a dump is work
    // A blocked writer is woken here as well: the handler does not distinguish the events.
    if (peer.wants_writable && read_count == 0) {
      output_.flush(peer);
      if (connections_.find(id) == nullptr || peer.session.closed()) return read_count;
    }
    if (peer.session.may_carry() && !may_receive(peer, buffer)) return read_count;
    auto packet = peer.session.socket().receive(buffer);
    if (!packet) {
      termination_.disconnect(peer, packet.error().what);
      return read_count;
    }
    if (packet->kind == Packet::Kind::nothing) return read_count;
    if (packet->kind == Packet::Kind::end) {
      termination_.disconnect(peer, "closed by the process");
      return read_count;
    }
    if (packet->credentials && !peer.session.identity().confirmed)
      confirm(peer.session.identity(), *packet->credentials);
    if (observes && (peer.session.has_output() || peer.asked)) {
      termination_.disconnect(peer, "an observer sent a request before it had read the answer");
      return read_count;
    }
    AGNOCAST_CRASH_POINT(B_request);
    const Envelope envelope{packet->descriptor_count, packet->truncated, packet->descriptors_lost};
    server_.serve_packet(peer, {buffer.data(), packet->bytes}, envelope, packet->fds());
  }
  return slice.packets_left;
}

// Closing a received descriptor may block, and the kernel may close some on the way. So a packet
// with descriptors stays in the socket and goes with its connection; only a window is received.
bool PacketReader::may_receive(Peer& peer, std::span<std::byte> buffer) {
  const auto next = peer.session.socket().peek(buffer);
  if (!next) {
    termination_.disconnect(peer, next.error().what);
    return false;
  }
  if (next->kind == Packet::Kind::nothing) {
    // By then, a sender that began just before the kernel refused descriptors has finished.
    constexpr std::uint64_t sending_ms = 1'000;
    if (!peer.brings_windows && refuses_descriptors(peer.session.socket().fd()) &&
        monotonic_ms() - peer.refuses_since_ms >= sending_ms)
      peer.session.set_may_carry(false);
    return false;
  }
  if (!next->has_descriptors) return true;
  wire::BringWindow window{};
  if (next->bytes == sizeof window)
    std::memcpy(static_cast<void*>(&window), buffer.data(), sizeof window);
  if (window.header.opcode == wire::Opcode::bring_window && peer.session.role() == Role::client &&
      peer.brings_windows && disposal_.may_receive(peer.session.identity().uid)) {
    receive_window(peer);
    return false;
  }
  const PeerId id = peer.id;
  server_.serve_packet(peer, buffer.first(next->bytes), {1, next->truncated, true}, {});
  if (Peer* const found = connections_.find(id); found != nullptr && !found->session.closed())
    termination_.disconnect(*found, "descriptors came with a packet");
  return false;
}

// All of it happens in another thread: for lack of a number the kernel closes arriving
// descriptors, and that thread closes every descriptor that is not a window.
void PacketReader::receive_window(Peer& peer) {
  const std::uint32_t uid = peer.session.identity().uid;
  // Another descriptor of the connection: the loop may close its own meanwhile.
  PacketSocket socket(UniqueFd(::fcntl(peer.session.socket().fd(), F_DUPFD_CLOEXEC, 0)));
  if (!socket) {
    termination_.disconnect(peer, "no descriptor is left to receive a window with");
    return;
  }
  const std::uint64_t ticket = scheduler_.next_ticket();
  scheduler_.park(peer, ticket);
  disposal_.receive(uid, std::move(socket), wire::packet_bytes_max,
                    [this, &disposal = disposal_, id = peer.id, ticket, uid,
                     here = std::weak_ptr(here_)](Disposal::Received& received) {
                      if (!here.expired()) serve_window(id, ticket, received);
                      disposal.close_memory(uid, std::move(received.memory.memory));
                    });
}

void PacketReader::serve_window(PeerId id, std::uint64_t ticket, Disposal::Received& received) {
  Peer* const peer = scheduler_.unpark(id, ticket);
  if (peer == nullptr) return;
  const Result<Packet>& packet = received.memory.packet;
  if (!packet) {
    termination_.disconnect(*peer, packet.error().what);
  } else if (packet->kind == Packet::Kind::data) {
    AGNOCAST_CRASH_POINT(B_request);
    server_.serve_packet(
        *peer, {received.bytes.data(), packet->bytes},
        {received.memory.descriptor_count, packet->truncated, packet->descriptors_lost},
        std::span(&received.memory.memory, 1));
  }
}

}  // namespace agnocast::daemon
