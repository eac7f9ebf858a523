// SPDX-License-Identifier: Apache-2.0
//
// UserNamespaces: see the header.

#include <daemon/serving/user_namespaces.hpp>

#include <base/descriptors/pidfd.hpp>
#include <base/sockets/peer_identity.hpp>
#include <daemon/death/region_look.hpp>

namespace agnocast::daemon {

void UserNamespaces::find(Peer& peer) {
  const PeerIdentity& identity = peer.session.identity();
  const auto known = identity.process.user_namespace();
  peer.session.user_namespace = known.value_or(0);
  if (known || identity.pid <= 0 ||
      errands_.waiting(Errands::Lane::looking, identity.uid) >= RegionLook::waiting_max)
    return;
  const std::uint64_t ticket = scheduler_.next_ticket();
  scheduler_.park(peer, ticket);
  const auto found = std::make_shared<std::uint64_t>(0);
  errands_.run(
      Errands::Lane::looking, identity.uid,
      [found, pid = identity.pid] { *found = agnocast::user_namespace_of(pid).value_or(0); },
      [this, found, id = peer.id, ticket, here = std::weak_ptr(here_)] {
        if (here.expired()) return;
        Peer* const at = connections_.find(id);
        if (at == nullptr) return;
        at->session.user_namespace = *found;
        scheduler_.unpark(id, ticket);
      });
}

}  // namespace agnocast::daemon
