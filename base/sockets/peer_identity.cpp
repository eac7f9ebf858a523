// SPDX-License-Identifier: Apache-2.0

#include <base/sockets/peer_identity.hpp>

#include <cerrno>

#ifndef SO_PEERPIDFD
#define SO_PEERPIDFD 77  // Linux 6.5; another number on parisc and sparc, which we do not support
#endif

namespace agnocast {
namespace {

// Kernels answer in different ways to an option they do not know; so do filters.
bool is_missing(int error) noexcept {
  return error == ENOPROTOOPT || error == EINVAL || error == ENOSYS || error == EOPNOTSUPP;
}

Result<std::vector<gid_t>> groups_of_peer(int socket) {
  // NGROUPS_MAX is 65536; nearly every process has fewer than 64 and needs one call.
  std::vector<gid_t> groups(64);
  for (;;) {
    auto bytes = static_cast<socklen_t>(groups.size() * sizeof(gid_t));
    const bool fits = ::getsockopt(socket, SOL_SOCKET, SO_PEERGROUPS, groups.data(), &bytes) == 0;
    if (!fits && errno != ERANGE)
      return fail(Errc::os_failure, "asking for the groups of a peer", errno);
    groups.resize(bytes / sizeof(gid_t));  // with ERANGE, the number of groups
    if (fits) return groups;
  }
}

}  // namespace

Result<PeerIdentity> identify_peer(int socket, PeerFacility facility) {
  ucred credentials{};
  socklen_t bytes = sizeof credentials;
  if (::getsockopt(socket, SOL_SOCKET, SO_PEERCRED, &credentials, &bytes) != 0)
    return fail(Errc::os_failure, "asking for the credentials of a peer", errno);
  auto groups = groups_of_peer(socket);
  if (!groups) return tl::unexpected(groups.error());

  PeerIdentity identity;
  identity.uid = credentials.uid;
  identity.gid = credentials.gid;
  identity.groups = std::move(*groups);
  identity.pid = credentials.pid;

  if (facility == PeerFacility::peer_pidfd) {
    int fd = -1;
    bytes = sizeof fd;
    if (::getsockopt(socket, SOL_SOCKET, SO_PEERPIDFD, &fd, &bytes) == 0) {  // CLOEXEC by itself
      identity.process = Pidfd(UniqueFd(fd));
      identity.confirmed = true;
      return identity;
    }
    if (!is_missing(errno)) return fail(Errc::os_failure, "asking for the pidfd of a peer", errno);
  }
  // pidfd_open(0) would fail with EINVAL; report the reason instead.
  if (identity.pid == 0)
    return fail(Errc::os_failure, "the peer lives in another pid namespace", ESRCH);
  auto process = Pidfd::open(identity.pid);
  if (!process) return tl::unexpected(process.error());
  identity.process = std::move(*process);
  return identity;
}

uid_t uid_of(int socket) noexcept {
  ucred credentials{};
  socklen_t bytes = sizeof credentials;
  return ::getsockopt(socket, SOL_SOCKET, SO_PEERCRED, &credentials, &bytes) == 0
             ? credentials.uid
             : static_cast<uid_t>(-1);
}

bool confirm(PeerIdentity& identity, const ucred& credentials) noexcept {
  if (identity.confirmed) return true;
  // uid and gid are not compared: SO_PEERCRED has the effective ones, a packet the real ones.
  // The order matters: first the packet was received, then the pidfd is checked.
  if (credentials.pid == 0 || credentials.pid != identity.pid) return false;
  identity.confirmed = !identity.process.ended();
  return identity.confirmed;
}

}  // namespace agnocast
