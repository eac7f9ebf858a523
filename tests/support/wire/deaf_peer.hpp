// SPDX-License-Identifier: Apache-2.0
//
// DeafPeer: makes TCP sockets whose last close() blocks for as long as requested.
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <vector>

namespace agnocast::test {

/// The other ends of lingering sockets: never accepted, so they read nothing, and alive as long as
/// this object.
class DeafPeer {
 public:
  DeafPeer() {
    EXPECT_EQ(::bind(listener_.get(), name(), sizeof address_), 0);
    EXPECT_EQ(::listen(listener_.get(), SOMAXCONN), 0);
    socklen_t bytes = sizeof address_;
    EXPECT_EQ(::getsockname(listener_.get(), name(), &bytes), 0);
  }
  /// Returns a TCP socket whose last close() blocks so long. Closing it by process exit does not
  /// block.
  UniqueFd lingering_socket(int seconds) const {
    UniqueFd socket(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    EXPECT_EQ(::connect(socket.get(), name(), sizeof address_), 0);
    const std::vector<char> text(1 << 16);
    while (::send(socket.get(), text.data(), text.size(), MSG_DONTWAIT | MSG_NOSIGNAL) > 0) {
    }
    const linger option{1, seconds};
    EXPECT_EQ(::setsockopt(socket.get(), SOL_SOCKET, SO_LINGER, &option, sizeof option), 0);
    return socket;
  }

 private:
  sockaddr* name() { return reinterpret_cast<sockaddr*>(&address_); }
  const sockaddr* name() const { return reinterpret_cast<const sockaddr*>(&address_); }
  sockaddr_in address_{
      .sin_family = AF_INET, .sin_port = 0, .sin_addr = {htonl(INADDR_LOOPBACK)}, .sin_zero = {}};
  UniqueFd listener_{::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)};
};

}  // namespace agnocast::test
