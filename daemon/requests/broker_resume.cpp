// SPDX-License-Identifier: Apache-2.0
//
// Broker: going on with a former life. docs/control-plane.md, "Restart".
//
// Tables, board, memory, bells and the identity of every process are what they were; connections are
// not. So everybody who lives is a process without a connection until it says rejoin, and whatever
// was journaled but not done, sent or rung is done again:
//
//     redo the change under way → the board says what the tables say → memory, bells and pidfds back
//     → what belongs to no living record is removed → deaths that happened meanwhile, reaps that did
//     not come to their end → what follows from the last records → every epoch moves, every bell rings
//
// Each step may be repeated: a daemon that dies in here is started again and begins here.

#include <daemon/requests/broker.hpp>

#include <base/check.hpp>
#include <journal/cases.hpp>

#include <sys/epoll.h>
#include <unistd.h>

#include <algorithm>
#include <utility>

namespace agnocast::daemon {

using journal::DeathReason;
using journal::FoundDecision;

Result<void> Broker::resume() {
  if (auto opened = registry_.open(); !opened) return opened;
  const TableHeader& header = registry_.header();
  options_.arena = {header.arena_base, header.arena_bytes, header.window_bytes};
  plan_ = AddressPlan(options_.arena, options_.former_count);
  const std::uint64_t repaired = registry_.repair_board();

  std::uint64_t lost = 0, living = 0;
  std::vector<ClientIndex> ended;
  for (std::uint32_t c = 0; c < registry_.client_high(); ++c) {
    const ClientIndex client{c};
    if (registry_.client(client).state == ClientState::free) continue;
    const auto found = adopt_client(client, lost);
    if (!found) return tl::unexpected(found.error());
    if (*found == FoundDecision::expect) ++living;
    if (*found == FoundDecision::recover || *found == FoundDecision::finish ||
        *found == FoundDecision::finish_and_watch)
      ended.push_back(client);
  }
  const std::size_t strangers = store_.remove_left_over();
  doorbells_.clear_strangers();
  const std::uint64_t dead = reap_while_away(ended);
  membership_.finish();
  registry_.note_recovered({static_cast<std::uint32_t>(::getpid()), dead, repaired});
  doorbells_.ring_all();
  log_.write(lost == 0 && repaired == 0 ? LogLevel::notice : LogLevel::error, "resumed",
             {{"restarts", header.counters.restarts},
              {"clients", living},
              {"ended_meanwhile", dead},
              {"board_words_repaired", repaired},
              {"descriptors_dropped", strangers},
              {"clients_lost", lost}});
  return {};
}

// A process without everything that is needed to look after it is treated as dead: its readers end
// with it, and its memory is not given to anybody else before they have.
Result<journal::FoundDecision> Broker::adopt_client(ClientIndex client, std::uint64_t& lost) {
  const ClientRecord& record = registry_.client(client);
  for (std::uint64_t w = 0; w < record.window_count; ++w) {
    if (record.window[w].bytes != options_.arena.window_bytes ||
        !plan_.adopt(record.window[w].base))
      return fail_with(Errc::store_damaged,
                       "what the former agnocastd left is damaged: the windows of a process");
  }
  const auto adopted = regions_.adopt_client(client, record.window_count, registry_.used_bytes_of(client));
  if (!adopted && adopted.error().code != Errc::endpoint_gone)
    return tl::unexpected(adopted.error());
  namespace stored = journal::stored;
  const std::uint8_t owner = record.state == ClientState::alive ? stored::alive
                             : registry_.is_revoked(client)     ? stored::revoked
                                                                : stored::dead;
  // What is to be removed is what is not taken here (remove_left_over).
  const auto takes = [&](std::uint8_t what) {
    return journal::decide_stored(what, true, owner) == journal::StoredDecision::take;
  };
  const auto loses_owner = [&](std::uint8_t what, bool is_there) {
    return journal::decide_stored(what, is_there, owner) == journal::StoredDecision::owner_is_lost;
  };
  UniqueFd process;
  if (takes(stored::process)) process = store_.take(DescriptorStore::process(client));
  for (std::uint64_t x = 0; takes(stored::bell) && x < abi::executor_count_max; ++x) {
    if ((record.executors >> x & 1) != 0) doorbells_.restore(client, x);
  }
  const bool is_lost = loses_owner(stored::memory, adopted.has_value()) ||
                       loses_owner(stored::process, static_cast<bool>(process));
  Pidfd pidfd(std::move(process));
  const bool lives = !is_lost && pidfd && !pidfd.ended();
  const FoundDecision decision =
      journal::decide_found(record.state == ClientState::alive  ? journal::found::alive
                            : record.state == ClientState::dead ? journal::found::dead
                                                                : journal::found::forgotten,
                            registry_.is_revoked(client), lives);
  if (decision == FoundDecision::expect) back_endpoints(client);
  if (decision == FoundDecision::expect || decision == FoundDecision::watch ||
      decision == FoundDecision::finish_and_watch) {
    if (auto watched = watch(client, std::move(pidfd)); !watched)
      return tl::unexpected(watched.error());
  } else if (registry_.is_revoked(client)) {
    // It has ended, as far as this daemon can know: its place need not be kept.
    registry_.client_died(client, DeathReason::died);
    store_.remove(DescriptorStore::process(client));
  }
  if (record.state == ClientState::forgotten) regions_.bury_client(client);
  if (is_lost) {
    ++lost;
    log_.write(LogLevel::error, "client lost",
               {{"client", number(client)},
                {"pid", record.pid},
                {"why", adopted ? "its pidfd was not kept" : adopted.error().what}});
  }
  return decision;
}

// The memory is there; its locks went with the former daemon's mapping. That the limit of memory is
// lower now is no reason to give anybody up.
void Broker::back_endpoints(ClientIndex client) {
  for (const EndpointRef& ref : registry_.endpoints_of(client)) {
    Result<void> backed;
    if (ref.kind == Kind::publisher) {
      const PublisherRecord& record = registry_.publisher(ref.topic, ref.index);
      backed = regions_.back(client, record.extent,
                             abi::slot_offset(abi::ring_count, record.slot_count));
    } else {
      const SubscriptionRecord& record = registry_.subscription(ref.topic, ref.index);
      backed = regions_.back(client, record.extent,
                             registry_.uses_far_slots(ref.topic)
                                 ? abi::subscription_extent_bytes
                                 : abi::far_hold_offset(abi::publisher_count_max, 0, 0));
    }
    if (!backed)
      log_.write_limited("back", LogLevel::warning, "memory not backed",
                         {{"client", number(client)}, {"errno", backed.error().os_errno}});
  }
}

Result<void> Broker::watch(ClientIndex client, Pidfd process) {
  const ClientRecord& record = registry_.client(client);
  PeerIdentity identity;
  identity.uid = record.uid;
  identity.gid = record.gid;
  identity.pid = static_cast<pid_t>(record.pid);
  identity.process = std::move(process);
  identity.confirmed = true;
  const PeerId id = connections_.next_id();
  auto peer = std::make_unique<Peer>(Peer{id, Session(PacketSocket(), std::move(identity))});
  const auto token = dispatcher_.add(peer->session.identity().process.fd(), EPOLLIN,
                                     scheduler_.event_handler(id, true));
  if (!token) return tl::unexpected(token.error());
  peer->process = *token;
  peer->session.greet(client);
  peer->detached = true;
  peer->revoked = registry_.is_revoked(client);
  if (!peer->revoked) connections_.set_client(client, peer.get());
  namespaces_.find(connections_.add(std::move(peer)));
  return {};
}

std::uint64_t Broker::reap_while_away(const std::vector<ClientIndex>& ended) {
  std::uint64_t dead = 0;
  for (const ClientIndex client : ended) {
    // The end of one may be the end of another that was waited for.
    const ClientState state = registry_.client(client).state;
    if (state == ClientState::alive) {
      termination_.repair(client, DeathReason::died, "ended while the daemon was away", UINT64_MAX);
      ++dead;
    } else if (state == ClientState::dead) {
      termination_.repair(client, registry_.client(client).reason,
             "its end was not finished by the former daemon", UINT64_MAX);
    }
  }
  return dead;
}

}  // namespace agnocast::daemon
