// SPDX-License-Identifier: Apache-2.0
//
// Recovery: see the header.

#include <daemon/requests/recovery.hpp>

#include <base/check.hpp>
#include <journal/cases.hpp>

#include <sys/epoll.h>
#include <unistd.h>

#include <algorithm>
#include <utility>

namespace agnocast::daemon {

using journal::DeathReason;
using journal::FoundDecision;

Result<void> Recovery::run() {
  const TableHeader& header = of_.registry.header();
  const std::uint64_t repaired = of_.registry.repair_board();

  std::uint64_t lost = 0, living = 0;
  std::vector<ClientIndex> ended;
  for (std::uint32_t c = 0; c < of_.registry.client_high(); ++c) {
    const ClientIndex client{c};
    if (of_.registry.client(client).state == ClientState::free) continue;
    const auto found = adopt_client(client, lost);
    if (!found) return tl::unexpected(found.error());
    if (*found == FoundDecision::expect) ++living;
    if (*found == FoundDecision::recover || *found == FoundDecision::finish ||
        *found == FoundDecision::finish_and_watch)
      ended.push_back(client);
  }
  const std::size_t leftovers = of_.store.remove_left_over();
  of_.doorbells.remove_unknown_names();
  const std::uint64_t dead = reap_while_away(ended);
  of_.endpoint_manager.carry_out_what_is_owed();
  of_.registry.note_recovered({static_cast<std::uint32_t>(::getpid()), dead, repaired});
  of_.doorbells.ring_all();
  of_.log.write(lost == 0 && repaired == 0 ? LogLevel::notice : LogLevel::error, "resumed",
                {{"restarts", header.counters.restarts},
                 {"clients", living},
                 {"ended_meanwhile", dead},
                 {"board_words_repaired", repaired},
                 {"descriptors_dropped", leftovers},
                 {"clients_lost", lost}});
  return {};
}

// A process that lacks something the daemon needs to watch it is treated as dead: its readers are
// notified of its end, and its memory is not given out before they have unmapped it.
Result<journal::FoundDecision> Recovery::adopt_client(ClientIndex client, std::uint64_t& lost) {
  const ClientRecord& record = of_.registry.client(client);
  for (std::uint64_t w = 0; w < record.window_count; ++w) {
    if (record.window[w].bytes != of_.arena.window_bytes || !of_.plan.adopt(record.window[w].base))
      return fail_with(Errc::store_damaged,
                       "the memory of the previous agnocastd is damaged: the windows of a process");
  }
  const auto adopted =
      of_.regions.adopt_client(client, record.window_count, of_.registry.used_bytes_of(client));
  if (!adopted && adopted.error().code != Errc::endpoint_gone)
    return tl::unexpected(adopted.error());
  namespace stored = journal::stored;
  const std::uint8_t owner = record.state == ClientState::alive ? stored::alive
                             : of_.registry.is_revoked(client)  ? stored::revoked
                                                                : stored::dead;
  // remove_left_over() removes what is not taken here.
  const auto takes = [&](std::uint8_t what) {
    return journal::decide_stored(what, true, owner) == journal::StoredDecision::take;
  };
  const auto loses_owner = [&](std::uint8_t what, bool is_there) {
    return journal::decide_stored(what, is_there, owner) == journal::StoredDecision::owner_is_lost;
  };
  UniqueFd process;
  if (takes(stored::process)) process = of_.store.take(DescriptorStore::process(client));
  for (std::uint64_t x = 0; takes(stored::doorbell) && x < abi::wait_set_count_max; ++x) {
    if ((record.wait_sets >> x & 1) != 0) of_.doorbells.restore(client, x);
  }
  const bool is_lost = loses_owner(stored::memory, adopted.has_value()) ||
                       loses_owner(stored::process, static_cast<bool>(process));
  Pidfd pidfd(std::move(process));
  const bool lives = !is_lost && pidfd && !pidfd.ended();
  const FoundDecision decision =
      journal::decide_found(record.state == ClientState::alive  ? journal::found::alive
                            : record.state == ClientState::dead ? journal::found::dead
                                                                : journal::found::forgotten,
                            of_.registry.is_revoked(client), lives);
  if (decision == FoundDecision::expect) back_endpoints(client);
  if (decision == FoundDecision::expect || decision == FoundDecision::watch ||
      decision == FoundDecision::finish_and_watch) {
    if (auto watched = watch(client, std::move(pidfd)); !watched)
      return tl::unexpected(watched.error());
  } else if (of_.registry.is_revoked(client)) {
    // It has ended, as far as this daemon can know: its place need not be kept.
    of_.registry.client_died(client, DeathReason::died);
    of_.store.remove(DescriptorStore::process(client));
  }
  if (record.state == ClientState::forgotten) of_.regions.unmap_client(client);
  if (is_lost) {
    ++lost;
    of_.log.write(LogLevel::error, "client lost",
                  {{"client", number(client)},
                   {"pid", record.pid},
                   {"why", adopted ? "its pidfd was not kept" : adopted.error().what}});
  }
  return decision;
}

// The memory exists; only the previous daemon's mapping is gone. A memory limit that is lower now
// is no reason to give up a process.
void Recovery::back_endpoints(ClientIndex client) {
  for (const EndpointRef& ref : of_.registry.endpoints_of(client)) {
    Result<void> backed;
    if (ref.kind == Kind::publisher) {
      const PublisherRecord& record = of_.registry.publisher(ref.topic, ref.index);
      backed = of_.regions.back(client, record.extent,
                                abi::slot_offset(abi::ring_count, record.slot_count));
    } else {
      const SubscriptionRecord& record = of_.registry.subscription(ref.topic, ref.index);
      backed = of_.regions.back(client, record.extent, abi::page_bytes);
      if (backed)
        backed = of_.regions.back_links(client, record.extent,
                                        of_.registry.slots_by_link_block(ref.topic));
    }
    if (!backed)
      of_.log.write_limited("back", LogLevel::warning, "memory not backed",
                            {{"client", number(client)}, {"errno", backed.error().os_errno}});
  }
}

Result<void> Recovery::watch(ClientIndex client, Pidfd process) {
  const ClientRecord& record = of_.registry.client(client);
  PeerIdentity identity;
  identity.uid = record.uid;
  identity.gid = record.gid;
  identity.pid = static_cast<pid_t>(record.pid);
  identity.process = std::move(process);
  identity.confirmed = true;
  const PeerId id = of_.connections.next_id();
  auto peer = std::make_unique<Peer>(Peer{id, Session(PacketSocket(), std::move(identity))});
  const auto token = of_.dispatcher.add(peer->session.identity().process.fd(), EPOLLIN,
                                        of_.scheduler.event_handler(id, true));
  if (!token) return tl::unexpected(token.error());
  peer->process = *token;
  peer->session.greet(client);
  peer->detached = true;
  peer->revoked = of_.registry.is_revoked(client);
  if (!peer->revoked) of_.connections.set_client(client, peer.get());
  of_.namespaces.find(of_.connections.add(std::move(peer)));
  return {};
}

std::uint64_t Recovery::reap_while_away(const std::vector<ClientIndex>& ended) {
  std::uint64_t dead = 0;
  for (const ClientIndex client : ended) {
    // The end of one process may already have ended another.
    const ClientState state = of_.registry.client(client).state;
    if (state == ClientState::alive) {
      of_.termination.reap(client, DeathReason::died, "ended while the daemon was away",
                           UINT64_MAX);
      ++dead;
    } else if (state == ClientState::dead) {
      of_.termination.reap(client, of_.registry.client(client).reason,
                           "the previous daemon did not finish its end", UINT64_MAX);
    }
  }
  return dead;
}

}  // namespace agnocast::daemon
