// SPDX-License-Identifier: Apache-2.0
//
// ClientTermination: see the header.

#include <daemon/death/client_termination.hpp>

#include <base/clock.hpp>
#include <daemon/state/memory_reserve.hpp>
#include <daemon/state/steps.hpp>
#include <daemon/state/user_log.hpp>
#include <journal/cases.hpp>

#include <sys/epoll.h>
#include <sys/socket.h>

#include <algorithm>
#include <utility>
#include <vector>

namespace agnocast::daemon {

using journal::DeathReason;
using journal::EndDecision;

namespace {

// Returns the client's case in journal::end.
std::uint8_t whose(const Peer& peer) noexcept {
  if (!peer.session.greeted()) return journal::end::unknown;
  return peer.revoked ? journal::end::revoked : journal::end::client;
}

}  // namespace

// Many may end in one round of the loop, which begins with a full reserve only if there is memory.
void ClientTermination::disconnect(Peer& peer, std::string_view why) {
  static_cast<void>(MemoryReserve::refill());
  const MemoryReserve::MustNotFail must_not_fail;
  MemoryReserve::no_return();
  AGNOCAST_CRASH_POINT(B_ended);
  dispatcher_.remove(peer.connection);
  peer.connection = 0;
  connections_.close(peer);
  const auto decision = journal::decide_end(whose(peer), false, false);
  if (decision == EndDecision::drop) {
    if (peer.session.role() == Role::observer)
      log_.write(LogLevel::debug, "observer gone",
                 {{"pid", peer.session.identity().pid}, {"why", why}});
    connections_.remove(peer.id);
    return;
  }
  const ClientIndex client = *peer.session.client();
  log_.write(LogLevel::debug, "connection closed",
             {{"client", number(client)}, {"pid", peer.session.identity().pid}, {"why", why}});
  connections_.detach(peer);
  // After exec, or when the library was shut down, the process has nothing of its region mapped.
  if (!peer.ended) look_whether_gone(peer);
}

void ClientTermination::reap(Peer& peer, DeathReason reason, std::string_view how) {
  static_cast<void>(MemoryReserve::refill());
  MemoryReserve::no_return();
  AGNOCAST_CRASH_POINT(B_reap);
  const PeerId id = peer.id;
  const auto decision = journal::decide_end(whose(peer), reason == DeathReason::died, true);
  if (decision == EndDecision::drop) {
    connections_.remove(id);
    return;
  }
  const ClientIndex client = *peer.session.client();
  connections_.set_client(client, nullptr);
  connections_.remove(id);
  if (decision == EndDecision::free_place) {
    const auto free_place = [this, client, reason, how = std::string(how)](const Reaped&) {
      free_revoked(client, reason, how);
    };
    if (!reaping_.append(client, free_place)) free_revoked(client, reason, how);
  } else {
    reap(client, reason, how);
  }
  AGNOCAST_CRASH_POINT(B_reaped);
}

// The rest was done at the revocation; now the place may be used again.
void ClientTermination::free_revoked(ClientIndex client, DeathReason reason, std::string_view how) {
  registry_.client_died(client, reason);
  store_.remove(DescriptorStore::process(client));
  const ClientRecord& record = registry_.client(client);
  log_for_user(log_, LogLevel::info, record.uid, "client gone",
               {{"client", number(client)},
                {"pid", record.pid},
                {"uid", record.uid},
                {"how", how},
                {"was", "revoked"}});
  endpoint_manager_.run(endpoint_manager_.endings().free_unused_client(client));
}

void ClientTermination::reap(ClientIndex client, DeathReason reason, std::string_view how,
                             std::uint64_t budget_ns) {
  const std::uint32_t uid = registry_.client(client).uid;
  const std::uint32_t pid = registry_.client(client).pid;
  obstacles_.forget(client);
  const auto after = [this, client, uid, pid, how = std::string(how)](const Reaped& reaped) {
    if (!registry_.is_revoked(client)) store_.remove(DescriptorStore::process(client));
    log_for_user(log_, reaped.corrupt == 0 ? LogLevel::info : LogLevel::warning, uid, "client gone",
                 {{"client", number(client)},
                  {"pid", pid},
                  {"uid", uid},
                  {"how", how},
                  {"publishers", reaped.publishers},
                  {"subscriptions", reaped.subscriptions},
                  {"rolled_back", reaped.rolled_back},
                  {"rolled_forward", reaped.rolled_forward},
                  {"corrupt_intents", reaped.corrupt}});
  };
  reaping_.begin(client, reason, after, budget_ns);
}

// Until the process ends, the peer stays, with its connection's place in the user's quota and its
// pidfd: until then the process has its memory and may not come back.
void ClientTermination::revoke(Peer& peer, const std::string& why) {
  static_cast<void>(MemoryReserve::refill());
  MemoryReserve::no_return();
  AGNOCAST_CRASH_POINT(B_revoke);
  const ClientIndex client = *peer.session.client();
  connections_.set_client(client, nullptr);
  peer.revoked = true;
  connections_.detach(peer);
  obstacles_.forget(client);
  const auto after = [this, client, pid = peer.session.identity().pid,
                      uid = peer.session.identity().uid, why](const Reaped& reaped) {
    log_.write(LogLevel::warning, "client revoked",
               {{"client", number(client)},
                {"pid", pid},
                {"uid", uid},
                {"why", why},
                {"publishers", reaped.publishers},
                {"subscriptions", reaped.subscriptions}});
  };
  reaping_.begin(client, DeathReason::revoked, after);
  if (peer.session.closed()) return;
  // Queued packets are about a session that it no longer has.
  peer.session.drop_output();
  auto packet = make_body<wire::Refused>(wire::Opcode::revoked);
  packet.code = static_cast<std::uint32_t>(Errc::revoked);
  packet.text = name_of(why);
  peer.session.push(packet_of(packet), {});
  shut_down(peer);
}

void ClientTermination::shut_down(Peer& peer) {
  if (peer.session.flush() == Session::Flushed::blocked) {
    dispatcher_.change(peer.connection, EPOLLOUT);  // its packets are no longer read
    return;
  }
  dispatcher_.remove(peer.connection);
  peer.connection = 0;
  // Not closed: unread requests of it would reset the connection and discard the queued packet.
  ::shutdown(peer.session.socket().fd(), SHUT_RDWR);
}

void ClientTermination::look_whether_gone(Peer& peer) {
  if (peer.looking) return;
  peer.looking = region_look_.begin(peer, [this, id = peer.id](RegionTrace trace) {
    Peer* const found = connections_.find(id);
    if (found == nullptr) return;
    found->looking = false;
    if (journal::decide_end(whose(*found), false, trace == RegionTrace::none) != EndDecision::wait)
      reap(*found, DeathReason::unmapped, "process unmapped its region");
  });
}

void ClientTermination::look_at_detached() {
  if (connections_.detached_count() == 0) return;
  std::vector<Peer*> lost;
  for (const auto& [id, peer] : connections_.all()) {
    if (peer->detached) lost.push_back(peer.get());
  }
  // Longest wait first: there may be no time for all.
  std::sort(lost.begin(), lost.end(),
            [](const Peer* a, const Peer* b) { return a->looked_ns < b->looked_ns; });
  for (Peer* const peer : lost) {
    if (peer->looking || peer->ended) continue;
    peer->looked_ns = monotonic_ns();
    look_whether_gone(*peer);
  }
}

}  // namespace agnocast::daemon
