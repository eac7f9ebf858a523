// SPDX-License-Identifier: Apache-2.0
//
// ConnectionTable: see the header.

#include <daemon/transport/connection_table.hpp>

#include <agnocast/abi/limits.hpp>
#include <base/check.hpp>
#include <daemon/state/memory_reserve.hpp>

#include <malloc.h>
#include <sys/socket.h>

#include <utility>

namespace agnocast::daemon {

namespace {

constexpr std::uint64_t worth_giving_back = std::uint64_t{8} << 20;

}  // namespace

ConnectionTable::ConnectionTable(Dispatcher& dispatcher, Disposal& disposal)
    : dispatcher_(dispatcher), disposal_(disposal), by_client_(abi::client_count_max, nullptr) {}

ConnectionTable::~ConnectionTable() {
  for (auto& [id, peer] : peers_) {
    dispatcher_.remove(peer->connection);
    dispatcher_.remove(peer->process);
    // The end of the process closes the socket without lingering; shutdown() notifies its peer
    // now.
    UniqueFd socket = peer->session.close();
    ::shutdown(socket.get(), SHUT_RDWR);
    static_cast<void>(socket.release());
  }
}

Peer& ConnectionTable::add(std::unique_ptr<Peer> peer) {
  UserConnections& user = users_[peer->session.identity().uid];
  ++(peer->counts_as_observer ? user.observers : user.clients);
  if (peer->detached) {
    ++detached_count_;
    ++user.detached;
  }
  const PeerId id = peer->id;
  return *peers_.emplace(id, std::move(peer)).first->second;
}

void ConnectionTable::remove(PeerId id) {
  const auto found = peers_.find(id);
  AGNOCAST_CHECK(found != peers_.end());
  Peer& peer = *found->second;
  dispatcher_.remove(peer.connection);
  dispatcher_.remove(peer.process);
  const auto user = users_.find(peer.session.identity().uid);
  AGNOCAST_CHECK(user != users_.end());
  std::uint64_t& count = peer.counts_as_observer ? user->second.observers : user->second.clients;
  AGNOCAST_CHECK(count > 0);
  --count;
  if (peer.detached) {
    --detached_count_;
    --user->second.detached;
  }
  if (user->second.clients + user->second.observers == 0) {
    gives_back_ |= user->second.kept->peak >= worth_giving_back;
    users_.erase(user);
  }
  if (peer.session.role() == Role::observer) --observer_count_;
  close(peer);
  peers_.erase(found);
}

void ConnectionTable::close(Peer& peer) {
  const MemoryReserve::MustNotFail must_not_fail;
  const bool may_carry = peer.session.may_carry();
  UniqueFd socket = peer.session.close();
  if (may_carry) disposal_.close_connection(peer.session.identity().uid, std::move(socket));
}

void ConnectionTable::detach(Peer& peer) {
  if (std::exchange(peer.detached, true)) return;
  peer.threads.reset();
  ++detached_count_;
  ++users_[peer.session.identity().uid].detached;
}

void ConnectionTable::become_observer(Peer& peer) {
  peer.session.observe();
  ++observer_count_;
}

void ConnectionTable::count_as_observer(Peer& peer) {
  if (std::exchange(peer.counts_as_observer, true)) return;
  UserConnections& user = users_[peer.session.identity().uid];
  --user.clients;
  ++user.observers;
}

void ConnectionTable::count_as_client(Peer& peer) {
  if (!std::exchange(peer.counts_as_observer, false)) return;
  UserConnections& user = users_[peer.session.identity().uid];
  --user.observers;
  ++user.clients;
}

Peer* ConnectionTable::find(PeerId id) const {
  const auto found = peers_.find(id);
  return found == peers_.end() ? nullptr : found->second.get();
}

void ConnectionTable::give_memory_back() {
  for (auto& [uid, user] : users_) {
    gives_back_ |= user.kept->peak >= worth_giving_back && user.kept->bytes < user.kept->peak / 4;
    if (user.kept->bytes < user.kept->peak / 4) user.kept->peak = user.kept->bytes;
  }
  if (std::exchange(gives_back_, false)) ::malloc_trim(0);
}

}  // namespace agnocast::daemon
