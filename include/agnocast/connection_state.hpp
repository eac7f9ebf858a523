// SPDX-License-Identifier: Apache-2.0
//
// Whether this process is connected with agnocastd. Messages between endpoints that know each other
// flow in every state; what needs the daemon is meeting others, creating endpoints, and getting a
// larger heap. The library comes back by itself as soon as the daemon is there again.
#pragma once

#include <agnocast/error.hpp>
#include <agnocast/export.hpp>

#include <cstdint>

namespace agnocast {

enum class ConnectionState : std::uint8_t {
  unconnected,   ///< no endpoint was created yet, or this is a forked child
  connected,     ///< as it should be
  reconnecting,  ///< the daemon is away; creations wait for it, for five seconds at most
  island,        ///< refused: it reaches those that it had reached before; see island_reason()
};

/// What a connection callback is told (events.hpp).
struct ConnectionInfo {
  ConnectionState state = ConnectionState::unconnected;
  Errc reason = Errc::ok;  ///< of an island, see island_reason()
};

/// Any thread; no system call, no allocation.
AGNOCAST_PUBLIC ConnectionState connection_state() noexcept;
/// Why this process is an island; ok as long as it is none. Creations fail with revoked, which is for
/// good, and with layout_mismatch, store_damaged, permission_denied, descriptors_withheld and daemon_untrusted until that
/// is mended. Otherwise (started_anew, …) the library goes to the new daemon by itself, at once or when it
/// has room. Any thread; no system call.
AGNOCAST_PUBLIC Errc island_reason() noexcept;

}  // namespace agnocast
