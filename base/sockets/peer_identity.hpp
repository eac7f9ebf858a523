// SPDX-License-Identifier: Apache-2.0
//
// Peer identity: the process at the other end of a Unix socket, from the kernel and never from a
// packet.
//
//   Linux 6.5 and later   SO_PEERPIDFD names the process that connected. Nothing else is needed.
//   before                pidfd_open(SO_PEERCRED.pid) may name a process that got the pid after the
//                         peer had died. So the identity is unconfirmed until a packet arrives
//                         whose kernel-made SCM_CREDENTIALS name the same pid while the pidfd has
//                         not ended: the pidfd kept the pid from being given away in between, so
//                         the sender is the process the pidfd names. Not possible across pid
//                         namespaces.
//
// The identity is that of the process that connected, not of a child that inherited the socket.
#pragma once

#include <agnocast/result.hpp>
#include <base/descriptors/pidfd.hpp>

#include <sys/socket.h>
#include <sys/types.h>

#include <cstdint>
#include <vector>

namespace agnocast {

struct PeerIdentity {
  uid_t uid = static_cast<uid_t>(-1);  ///< effective, when it connected
  gid_t gid = static_cast<gid_t>(-1);
  std::vector<gid_t> groups;  ///< supplementary, when it connected
  pid_t pid = 0;              ///< in our pid namespace; 0 if it has none there
  Pidfd process;
  bool confirmed = false;  ///< false: wait for a packet that confirm() accepts
};

/// Facilities that identify_peer may use. Tests disable one; other callers use the default.
enum class PeerFacility : std::uint8_t { peer_pidfd, only_pidfd_open };

/// Returns the identity of the process that connected `socket`. Errors: os_failure with errno
/// (ESRCH: the peer is gone, or lives in another pid namespace of a kernel before 6.5). Allocates
/// for the groups.
[[nodiscard]] Result<PeerIdentity> identify_peer(int socket,
                                                 PeerFacility facility = PeerFacility::peer_pidfd);

/// Returns the effective uid of the process that connected `socket`; the highest number if
/// unknown.
uid_t uid_of(int socket) noexcept;

/// Checks the credentials of one packet. Returns true once the identity is confirmed. A packet of
/// another process, or after the end of the process, changes nothing and returns false.
bool confirm(PeerIdentity& identity, const ucred& credentials) noexcept;

}  // namespace agnocast
