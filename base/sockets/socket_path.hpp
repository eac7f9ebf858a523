// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace agnocast {

/// The socket of the daemon that root starts.
inline constexpr const char* system_socket = "/run/agnocast/agnocastd.sock";
/// The socket of any other user's daemon, below $XDG_RUNTIME_DIR.
inline constexpr const char* user_socket = "/agnocast/agnocastd.sock";

/// Returns the socket of this process's daemon: $AGNOCAST_SOCKET, else the system's, else the
/// user's own.
std::string socket_path();

}  // namespace agnocast
