// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace agnocast {

/// Where the daemon of this process listens: $AGNOCAST_SOCKET, else the system's, else the user's own.
std::string socket_path();

}  // namespace agnocast
