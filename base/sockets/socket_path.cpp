// SPDX-License-Identifier: Apache-2.0

#include <base/sockets/socket_path.hpp>

#include <unistd.h>

#include <cstdlib>

namespace agnocast {

std::string socket_path() {
  if (const char* named = ::secure_getenv("AGNOCAST_SOCKET"); named != nullptr && *named != '\0')
    return named;
  if (::access(system_socket, F_OK) == 0) return system_socket;
  if (const char* runtime = ::secure_getenv("XDG_RUNTIME_DIR");
      runtime != nullptr && *runtime == '/') {
    return std::string(runtime) + user_socket;
  }
  return system_socket;
}

}  // namespace agnocast
