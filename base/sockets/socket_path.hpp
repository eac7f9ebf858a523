// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace agnocast {

/// Returns the socket of this process's daemon: $AGNOCAST_SOCKET, else the system's, else the
/// user's own.
std::string socket_path();

}  // namespace agnocast
