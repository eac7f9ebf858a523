// SPDX-License-Identifier: Apache-2.0
//
// Connecting to agnocastd, and to nobody else: what listens at the path may be another user's program,
// which would be told who we are and whose memory we would map. The kernel says who made the socket listen
// (SO_PEERCRED). Trusted are, in this order:
//
//   root              the system's daemon; also behind a socket that systemd has made
//   this user         its own daemon
//   $AGNOCAST_DAEMON_UID  whom the environment of this process names, by number
//   whom root has given the directory of the socket: its owner, where only root can write beside it,
//                     and no name on the way is a link (RuntimeDirectory= of a unit with User=)
//
// Effective ids count, and a program with raised rights (AT_SECURE) reads no variable. In a user namespace
// all users of the host without a number there are one, the overflow uid: that one is nobody's own.
#pragma once

#include <agnocast/result.hpp>
#include <base/packet_socket.hpp>

#include <sys/types.h>

#include <chrono>
#include <string>
#include <string_view>

namespace agnocast {

/// As PacketSocket::connect, and asks who listens. Further error: daemon_untrusted.
[[nodiscard]] Result<PacketSocket> connect_to_daemon(
    const std::string& path,
    std::chrono::milliseconds patience = PacketSocket::connect_patience) noexcept;

/// Whether this number stands for users of the host that have none in this user namespace.
bool is_unknown_user(uid_t user);

/// What is_trusted_server() goes by, beside the file system.
struct ServerFacts {
  uid_t server = 0;
  uid_t self = 0;               ///< effective
  std::string_view named = {};  ///< $AGNOCAST_DAEMON_UID
  bool (*is_unknown)(uid_t) = is_unknown_user;
};
/// Whether the user that listens at `path` is one of those above.
bool is_trusted_server(const ServerFacts& facts, const std::string& path);

}  // namespace agnocast
