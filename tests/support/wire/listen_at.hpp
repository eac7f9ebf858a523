// SPDX-License-Identifier: Apache-2.0
//
// Makes a listening socket with the mode that bind() gives it.
#pragma once

#include <base/sockets/packet_socket.hpp>

#include <string_view>

namespace agnocast::test {

[[nodiscard]] inline Result<PacketListener> listen_at(std::string_view path) {
  auto listener = PacketListener::bind(path);
  if (!listener) return listener;
  if (Result<void> listening = listener->listen(); !listening)
    return tl::unexpected(listening.error());
  return listener;
}

}  // namespace agnocast::test
