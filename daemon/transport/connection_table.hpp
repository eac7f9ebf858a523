// SPDX-License-Identifier: Apache-2.0
//
// ConnectionTable: every connection and the process at its other end, found by number and by
// client; and how many of them each user has.
//
//   accepted ──▶ attached ──connection lost──▶ detached ──process ended or came back──▶ removed
//                        ──revoked──────────▶ detached
//
// A peer outlives its connection: as long as its process lives and has memory of the daemon, it
// keeps its place here. A connection that waits to be closed by Disposal has no peer.
#pragma once

#include <agnocast/abi/observe.hpp>
#include <agnocast/abi/wire.hpp>
#include <daemon/state/callback_threads.hpp>
#include <daemon/state/tables.hpp>
#include <daemon/transport/allowance.hpp>
#include <daemon/transport/dispatcher.hpp>
#include <daemon/transport/disposal.hpp>
#include <daemon/transport/session.hpp>

#include <cstdint>
#include <memory>
#include <optional>
#include <unordered_map>
#include <variant>
#include <vector>

namespace agnocast::daemon {

/// Numbers of connections are never used twice.
using PeerId = std::uint64_t;
/// What a process has mapped of its region. Unknown: no time to look now, or no descriptor.
enum class RegionTrace : std::uint8_t { none, some, unknown };
/// A request of an observer with a long answer.
using LongRequest = std::variant<wire::Dump, wire::ReadJournal>;
/// The callback groups and threads of a process, which count for its user.
class ThreadsOfPeer {
 public:
  explicit ThreadsOfPeer(const std::shared_ptr<KeptForUser>& user) noexcept
      : groups_(user, &KeptForUser::callback_groups),
        threads_(user, &KeptForUser::callback_threads),
        spins_(user, &KeptForUser::callback_spins) {}
  CallbackThreads table;
  /// Call it after each change of the table.
  void count() noexcept {
    groups_.set(table.groups().size());
    threads_.set(table.threads().size());
    spins_.set(table.spin_count());
  }

 private:
  ShareOfUser groups_, threads_, spins_;
};
struct Peer {
  PeerId id;
  Session session;
  Dispatcher::Token connection = 0;
  Dispatcher::Token process = 0;
  bool wants_writable = false;
  bool waits = false;     // for its time slice
  bool ended = false;     // the process has ended; its time slice is the last
  bool detached = false;  // without a connection, or revoked, but alive and mapping its region
  bool revoked = false;   // its client is dead in the tables; its packets are ignored
  bool counts_as_observer = false;
  std::uint64_t parked = 0;                           // it waits for the errand with this ticket
  bool brings_windows = false;                        // it may, until its first other request
  std::uint64_t refuses_since_ms = 0;                 // since when the kernel refuses them again
  std::uint64_t asked_ms = 0;                         // observer: when its last answer was made
  std::optional<LongRequest> asked = {};              // observer: to answer in its user's slice
  std::optional<wire::WatchGraph> awaits_graph = {};  // to answer at the next change of the graph
  bool is_listed = false;       // GraphRequests has it in its list of those who wait
  std::uint64_t looked_ns = 0;  // when tick() last looked for its region
  bool looking = false;         // a thread looks right now
  // Before hello: whether the process was looked at, and what it has of a revoked region.
  std::optional<RegionTrace> revoked_trace = {};
  std::unique_ptr<ThreadsOfPeer> threads = {};  // null: it has said nothing of them
  // Limits how often its process comes back, which costs work. An honest one tries at most four
  // times a second (client/connection/reconnection.hpp), a few times more often at first.
  Allowance returns{20, 250};
};
/// Connections of one user.
struct UserConnections {
  std::uint64_t clients = 0;
  std::uint64_t observers = 0;
  std::uint64_t detached = 0;     // clients without a connection
  std::uint64_t look_due_ns = 0;  // before that no process of this user is looked at
  std::shared_ptr<KeptForUser> kept = std::make_shared<KeptForUser>();
};

class ConnectionTable {
 public:
  using Peers = std::unordered_map<PeerId, std::unique_ptr<Peer>>;
  using Users = std::unordered_map<std::uint32_t, UserConnections>;

  ConnectionTable(Dispatcher& dispatcher, Disposal& disposal);
  /// Shuts every connection down; the end of the process closes them.
  ~ConnectionTable();
  ConnectionTable(const ConnectionTable&) = delete;
  ConnectionTable& operator=(const ConnectionTable&) = delete;

  PeerId next_id() noexcept { return ++last_id_; }
  /// Takes over a peer and counts it for its user.
  Peer& add(std::unique_ptr<Peer> peer);
  /// Removes a peer from the table and from the dispatcher, and closes its connection.
  void remove(PeerId id);
  /// Closes the connection; the peer stays.
  void close(Peer& peer);
  /// Marks a peer whose connection is lost or whose session is over. Repeated calls do nothing.
  void detach(Peer& peer);
  void become_observer(Peer& peer);
  void count_as_observer(Peer& peer);
  void count_as_client(Peer& peer);

  /// Returns the peer; null: it is gone.
  Peer* find(PeerId id) const;
  /// Returns the peer of a client; null: no client has this place.
  Peer* of_client(ClientIndex client) const noexcept { return by_client_[number(client)]; }
  void set_client(ClientIndex client, Peer* peer) noexcept { by_client_[number(client)] = peer; }
  const Peers& all() const noexcept { return peers_; }
  UserConnections& user(std::uint32_t uid) { return users_[uid]; }
  Users& users() noexcept { return users_; }
  const Users& users() const noexcept { return users_; }
  std::uint64_t detached_count() const noexcept { return detached_count_; }
  std::uint64_t observer_count() const noexcept { return observer_count_; }

  /// Returns freed pages from malloc to the system once most of the queued output is gone.
  void give_memory_back();

 private:
  Dispatcher& dispatcher_;
  Disposal& disposal_;
  Peers peers_;
  std::vector<Peer*> by_client_;
  Users users_;  // by uid
  PeerId last_id_ = 0;
  std::uint64_t detached_count_ = 0;  // processes without a connection
  std::uint64_t observer_count_ = 0;
  bool gives_back_ = false;  // much queued output is gone
};

}  // namespace agnocast::daemon
