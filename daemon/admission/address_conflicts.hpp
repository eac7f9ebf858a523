// SPDX-License-Identifier: Apache-2.0
//
// AddressConflicts: a heap lies where one of its readers has another mapping (obstacles.hpp).
//
//   publisher's process:  | window 0 | window 1 |         window 0 is given up, window 1 is used
//   subscriber's process: |     a JIT |         |         gets later messages
//
// Nothing that exists is moved. Both endpoints get a notice, and the owner of the heap is asked to
// open a window that all its readers can map and to allocate from that one alone: the new window
// begins a window set. Messages in the previous window set are lost to that subscription; others
// read them as before. A process is asked heap_move_max times at most, and only if there is such a
// window; otherwise its heap stays where it is. Claims of other users never use up the last of
// anything: a move, a window and its bytes in the quota remain for claims of the owner's own user,
// which harm no other user.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <base/sockets/peer_identity.hpp>
#include <base/text/log.hpp>
#include <daemon/admission/admission.hpp>
#include <daemon/config/config.hpp>
#include <daemon/lifecycle/endpoint_manager.hpp>
#include <daemon/state/address_plan.hpp>
#include <daemon/state/obstacles.hpp>
#include <daemon/state/registry.hpp>

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>

namespace agnocast::daemon {

class AddressConflicts {
 public:
  AddressConflicts(const Config::Heap& heap, const Arena& arena, const Registry& registry,
                   const Admission& admission, AddressPlan& plan, Obstacles& obstacles,
                   EndpointManager& endpoint_manager, ClientChannel& channel, Log& log) noexcept
      : heap_(heap),
        arena_(arena),
        registry_(registry),
        admission_(admission),
        plan_(plan),
        obstacles_(obstacles),
        endpoint_manager_(endpoint_manager),
        channel_(channel),
        log_(log) {}

  /// Forgets the findings of the previous request.
  void begin_request() { why_not_moved_.clear(); }
  /// Adds a range of the arena that a process reports as blocked. Errors: as Obstacles::add.
  [[nodiscard]] Result<void> add_obstacle(const PeerIdentity& identity, ClientIndex client,
                                          const wire::Blocked& range);
  /// Chooses the next window of a process: one that the process can map, and that as few others as
  /// possible cannot. Errors: arena_occupied, limit_reached.
  [[nodiscard]] Result<WindowRecord> choose_window(ClientIndex client);

  /// Look for conflicts, notify both processes of new ones, and ask the owner of the heap to move.
  void look_at(const EndpointRef& publisher, const EndpointRef& subscription);
  void look_at_publishers_of(ClientIndex owner);
  void look_at_subscriptions_of(ClientIndex reader);

 private:
  /// A window that `reader` cannot map, in the window set that `owner` allocates from.
  struct Collision {
    std::uint64_t window = 0;
    const Obstacles::Claim* claim = nullptr;
  };
  std::optional<Collision> collision(ClientIndex owner, ClientIndex reader) const;
  /// Returns why the owner's heap does not move for this reader; empty: it moves.
  const std::string& why_not_moved(ClientIndex owner, ClientIndex reader);
  std::string find_why_not_moved(ClientIndex owner, ClientIndex reader) const;
  bool should_move(ClientIndex owner) const;
  template <class Function>
  void for_each_match(ClientIndex client, Kind kind, Function function) const;

  const Config::Heap& heap_;
  const Arena& arena_;
  const Registry& registry_;
  const Admission& admission_;
  AddressPlan& plan_;
  Obstacles& obstacles_;
  EndpointManager& endpoint_manager_;
  ClientChannel& channel_;
  Log& log_;
  // By owner and reader; for the current request only.
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::string> why_not_moved_;
};

}  // namespace agnocast::daemon
