// SPDX-License-Identifier: Apache-2.0
//
// RejoinRequests: see the header.

#include <daemon/requests/rejoin_requests.hpp>

#include <base/clock.hpp>
#include <daemon/admission/check_caller.hpp>
#include <daemon/requests/rejoin_facts.hpp>
#include <daemon/state/memory_reserve.hpp>
#include <daemon/state/steps.hpp>
#include <daemon/transport/brought_windows.hpp>
#include <journal/cases.hpp>

#include <cstdint>
#include <string>
#include <utility>

namespace agnocast::daemon {

// Returns the peer of the process's previous connection.
Result<Peer*> RejoinRequests::lost_peer(const Peer& peer, const wire::Rejoin& request) {
  using journal::RejoinDecision;
  const ClientIndex client{static_cast<std::uint32_t>(request.client)};
  Peer* const before =
      names_place(request, of_.registry) ? of_.connections.of_client(client) : nullptr;
  const bool is_same = before != nullptr && same_process(before->session.identity().process,
                                                         peer.session.identity().process);
  const Rejoiner who{peer.session.identity().confirmed, before != nullptr, is_same};
  switch (journal::decide_rejoin(rejoin_facts(request, of_.registry, who))) {
    case RejoinDecision::take_back:
      return before;
    case RejoinDecision::started_anew:
      return fail_with(Errc::started_anew, "the daemon does not know this process");
    case RejoinDecision::revoked:
      return fail_with(Errc::revoked, "the session of this process is over");
    case RejoinDecision::layout_mismatch:
    case RejoinDecision::permission_denied:
      break;
  }
  // check_caller() has given the other reasons for these two.
  return fail_with(Errc::permission_denied, "that is the place of another process");
}

Result<void> RejoinRequests::rejoin(Peer& peer, const wire::Rejoin& request) {
  if (auto known = check_caller(peer.session.identity(), request.fingerprint); !known) return known;
  const auto before = lost_peer(peer, request);
  if (!before) return tl::unexpected(before.error());
  const ClientIndex client{static_cast<std::uint32_t>(request.client)};
  peer.returns = (*before)->returns;
  if (!peer.returns.take(monotonic_ms()))
    return fail_with(Errc::limit_reached, "this process comes back too often; try again later");
  // The rules may have changed since it was admitted.
  if (const std::string why = of_.access.forbidden_endpoint(client, peer.session.identity());
      !why.empty()) {
    of_.termination.revoke(**before, why);
    return fail_with(Errc::revoked, why);
  }
  of_.access.warn_of_other_readers(client);
  MemoryReserve::no_return();
  // It may have been counted as one more process because the daemon had not yet seen the end of
  // its old connection.
  of_.connections.count_as_client(peer);
  peer.session.greet(client);
  of_.connections.set_client(client, &peer);
  of_.connections.remove((*before)->id);
  if (of_.registry.endpoints_of(client).empty() && of_.registry.client(client).wait_sets == 0)
    expect_windows(peer);
  of_.registry.note_rejoined(client);
  auto packet = make_body<wire::Rejoined>(wire::Opcode::rejoined, request.header.request);
  packet.incarnation = of_.registry.incarnation();
  of_.output.reply(peer, packet_of(packet));
  of_.unmap_watch.notified_again(client);
  renew_doorbells(peer);
  of_.endpoint_manager.welcome_back(client);
  of_.conflicts.look_at_publishers_of(client);  // a request to move may have been lost
  of_.log.write(LogLevel::debug, "client is back",
                {{"client", number(client)}, {"pid", peer.session.identity().pid}});
  return {};
}

// Without them its wait sets would be deaf to publishers of other users for as long as it lives.
void RejoinRequests::renew_doorbells(Peer& peer) {
  const ClientIndex client = *peer.session.client();
  const std::uint64_t wait_sets = of_.registry.client(client).wait_sets;
  for (std::uint64_t wait_set = 0; wait_set < abi::wait_set_count_max; ++wait_set) {
    if ((wait_sets >> wait_set & 1) == 0) continue;
    auto doorbells = of_.doorbells.renew(client, wait_set, of_.registry.client(client).uid);
    if (!doorbells || doorbells->empty()) continue;
    AGNOCAST_CRASH_POINT(B_doorbell_bound);
    auto packet = make_body<wire::DoorbellsRenewed>(wire::Opcode::doorbells_renewed);
    packet.wait_set = wait_set;
    of_.output.reply(peer, packet_of(packet), std::move(*doorbells));
    of_.endpoint_manager.renewed(client, wait_set);
  }
}

}  // namespace agnocast::daemon
