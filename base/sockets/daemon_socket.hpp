// SPDX-License-Identifier: Apache-2.0
//
// Connects to agnocastd only: another user's program may listen at the path. It would learn the
// identity of this process, which would map its memory. The kernel knows which user made the
// socket listen (SO_PEERCRED). Trusted are, in this order:
//
//   root              the system's daemon; also behind a socket that systemd has made
//   this user         its own daemon
//   $AGNOCAST_DAEMON_UID  the user with this number
//   the owner of the socket's directory, if root gave it to that user: only root can write
//                     beside it, and no name on the way is a link (RuntimeDirectory= of a unit
//                     with User=)
//
// Effective ids count, and a program with raised rights (AT_SECURE) reads no variable. In a user
// namespace all users of the host without a number share one, the overflow uid, which never
// counts as this user.
#pragma once

#include <agnocast/result.hpp>
#include <base/sockets/packet_socket.hpp>

#include <sys/types.h>

#include <chrono>
#include <string>
#include <string_view>

namespace agnocast {

/// As PacketSocket::connect, and checks the listening user. Further error: daemon_untrusted.
[[nodiscard]] Result<PacketSocket> connect_to_daemon(
    const std::string& path,
    std::chrono::milliseconds patience = PacketSocket::connect_patience) noexcept;

/// Returns whether this number stands for users of the host that have none in this user
/// namespace.
bool is_unknown_user(uid_t user);

/// Input of is_trusted_server(), besides the file system.
struct ServerFacts {
  uid_t server = 0;
  uid_t self = 0;               ///< effective
  std::string_view named = {};  ///< $AGNOCAST_DAEMON_UID
  bool (*is_unknown)(uid_t) = is_unknown_user;
};
/// Returns whether the user that listens at `path` is one of those above.
bool is_trusted_server(const ServerFacts& facts, const std::string& path);

}  // namespace agnocast
