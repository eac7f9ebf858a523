// SPDX-License-Identifier: Apache-2.0
//
// State of the connection of this process to agnocastd. Messages between endpoints that are already
// connected flow in every state. The daemon is needed to match new endpoints, to create endpoints
// and to enlarge the heap. The library reconnects by itself as soon as the daemon is back.
#pragma once

#include <agnocast/error.hpp>
#include <agnocast/export.hpp>
#include <agnocast/result.hpp>

#include <cstdint>

namespace agnocast {

enum class ConnectionState : std::uint8_t {
  unconnected,   ///< no endpoint was created yet, or this is a forked child
  connected,     ///< the normal state
  reconnecting,  ///< the daemon is away; creations wait for it, five seconds at most
  orphaned,      ///< refused by the daemon (orphan_reason()); existing matches go on, nothing new
                 ///< is created
};

/// The argument of a connection callback (events.hpp).
struct ConnectionInfo {
  ConnectionState state = ConnectionState::unconnected;
  Errc reason = Errc::ok;  ///< of an orphaned session, see orphan_reason()
};

/// Returns the present state. Any thread; no system call, no allocation.
AGNOCAST_PUBLIC ConnectionState connection_state() noexcept;
/// Returns why the session of this process is orphaned; ok if it is not. Creations fail with
/// revoked for good, and with layout_mismatch, store_damaged, permission_denied,
/// descriptors_withheld and daemon_untrusted until the cause is removed. For other reasons
/// (started_anew, …) the library joins the new daemon by itself, at once or when that has room.
/// Any thread; no system call.
AGNOCAST_PUBLIC Errc orphan_reason() noexcept;

/// Returns the ROS domain of this process, that of an endpoint whose node names no other one.
/// Before agnocastd has accepted the first endpoint: ROS_DOMAIN_ID or 0. Any thread; until then, no
/// other may change the environment meanwhile. Errors: invalid_argument (not a number, or a program
/// with raised rights).
[[nodiscard]] AGNOCAST_PUBLIC Result<std::uint64_t> domain_id();

}  // namespace agnocast
