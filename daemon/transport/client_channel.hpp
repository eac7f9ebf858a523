// SPDX-License-Identifier: Apache-2.0
//
// ClientChannel: how the daemon's parts send to processes, and how a packet is made.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <daemon/state/tables.hpp>
#include <daemon/transport/request_reading.hpp>
#include <daemon/transport/session.hpp>
#include <daemon/transport/shared_fd.hpp>

#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

namespace agnocast::daemon {

/// Sends to processes. Packets for a process without a connection are dropped.
class ClientChannel {
 public:
  virtual ~ClientChannel() = default;
  virtual Session* session_of(ClientIndex client) = 0;
  /// Returns 0 when unknown. Needs no connection.
  virtual std::uint64_t user_namespace_of(ClientIndex client) = 0;
  virtual void send(ClientIndex client, Outgoing packet) = 0;
  void send(ClientIndex client, std::span<const std::byte> packet, std::vector<SharedFd> fds) {
    send(client, Outgoing{{packet.begin(), packet.end()}, std::move(fds), {}});
  }
  /// Ends the connection of a process. It comes back and is notified of everything once more.
  virtual void begin_anew(ClientIndex client, std::string_view why) = 0;
};

template <class Body>
std::span<const std::byte> packet_of(const Body& body) noexcept {
  return std::as_bytes(std::span(&body, 1));
}
template <class Body>
Body make_body(wire::Opcode opcode, std::uint64_t request = 0) noexcept {
  Body body{};
  body.header = {opcode, sizeof(Body), request};
  return body;
}

}  // namespace agnocast::daemon
