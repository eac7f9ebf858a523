// SPDX-License-Identifier: Apache-2.0
//
// AddressConflicts: a heap lies where a process that reads from it has something else
// (obstacles.hpp).
//
//   publisher's process:  | window 0 | window 1 |         window 0 is given up, it goes on in window 1
//   subscriber's process: |     a JIT |         |         gets what is published from then on
//
// Nothing that exists is moved. Both endpoints get a notice, and the owner of the heap is asked to
// open a window that all its readers can map and to allocate from that one alone: the new window
// begins a window set. What lies in the window set before is lost to that subscription; the others
// read it as ever. A process is asked heap_move_max times at most, and only if there is such a
// window: then its heap stays where it is. What another user claims never takes the last of
// anything: a move, a window and its bytes in the quota remain for the owner's own user, whose
// claims are not lies about other users.
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

  /// Forgets what was found out for the request before this one.
  void begin_request() { why_not_moved_.clear(); }
  /// A process says that it has something else in the arena. Errors: as Obstacles::add.
  [[nodiscard]] Result<void> add_obstacle(const PeerIdentity& identity, ClientIndex client,
                                          const wire::Blocked& range);
  /// Chooses the next window of a process: one that the process itself can map, and that as few
  /// others as possible cannot. Errors: arena_occupied, limit_reached.
  [[nodiscard]] Result<WindowRecord> choose_window(ClientIndex client);

  /// Look for conflicts, tell both processes of those that are new, and ask the owner of the heap
  /// to move.
  void look_at(const EndpointRef& publisher, const EndpointRef& subscription);
  void look_at_publishers_of(ClientIndex owner);
  void look_at_subscriptions_of(ClientIndex reader);

 private:
  /// A window of the window set that `owner` allocates from and `reader` cannot map.
  struct Collision {
    std::uint64_t window = 0;
    const Obstacles::Claim* claim = nullptr;
  };
  std::optional<Collision> collision(ClientIndex owner, ClientIndex reader) const;
  /// Returns why its heap does not move for this reader; empty: it does.
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
  // By owner and reader; of the request that is being served.
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::string> why_not_moved_;
};

}  // namespace agnocast::daemon
