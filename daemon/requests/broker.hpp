// SPDX-License-Identifier: Apache-2.0
//
// Broker: builds and owns everything below, and turns events into operations.
//
//   listener readable     accept, identify, watch connection and process
//   connection readable   its turn comes: decode, check rights and quotas, membership
//   connection ended      keep (the process lives), or reap (it has no trace of its region)
//   rejoin                the new connection takes the place of the one that the process lost
//   pidfd readable        its turn comes: what it said last, then reap
//   observer says revoke  reap although it lives; it is told, and its pidfd stays watched
//   started again         Recovery
//
// Turns are the users': who has a thousand connections is served as much as who has one.
//
// One thread; what may take as long as a client likes is done in others (errands.hpp, disposal.hpp), and so is
// the freeing of memory (closer.hpp). A connection that waits for an errand is parked: nothing is read from it
// until then. The order of things inside one event is the
// protocol's; between events everything is consistent, so the daemon may be killed at any time.
#pragma once

#include <base/log.hpp>
#include <daemon/config/config.hpp>
#include <daemon/death/client_termination.hpp>
#include <daemon/death/hold_watch.hpp>
#include <daemon/death/let_go_watch.hpp>
#include <daemon/death/reaping_queue.hpp>
#include <daemon/death/region_look.hpp>
#include <daemon/lifecycle/membership.hpp>
#include <daemon/lifecycle/regions.hpp>
#include <daemon/requests/access_control.hpp>
#include <daemon/requests/acknowledgement_requests.hpp>
#include <daemon/requests/address_conflicts.hpp>
#include <daemon/requests/admission.hpp>
#include <daemon/requests/dump_collector.hpp>
#include <daemon/requests/endpoint_requests.hpp>
#include <daemon/requests/executor_requests.hpp>
#include <daemon/requests/hello_requests.hpp>
#include <daemon/requests/observer_answers.hpp>
#include <daemon/requests/observer_requests.hpp>
#include <daemon/requests/recovery.hpp>
#include <daemon/requests/refusal_report.hpp>
#include <daemon/requests/rejoin_requests.hpp>
#include <daemon/requests/request_scheduler.hpp>
#include <daemon/requests/request_server.hpp>
#include <daemon/requests/user_namespaces.hpp>
#include <daemon/requests/window_requests.hpp>
#include <daemon/state/address_plan.hpp>
#include <daemon/state/obstacles.hpp>
#include <daemon/state/refusals.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/allowance.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/descriptor_store.hpp>
#include <daemon/transport/dispatcher.hpp>
#include <daemon/transport/disposal.hpp>
#include <daemon/transport/doorbells.hpp>
#include <daemon/transport/errands.hpp>
#include <daemon/transport/listener.hpp>
#include <daemon/transport/peer_output.hpp>
#include <daemon/transport/requests.hpp>
#include <daemon/transport/session.hpp>
#include <journal/cases.hpp>

#include <cstdint>
#include <deque>
#include <functional>
#include <list>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <unordered_map>
#include <variant>
#include <vector>

namespace agnocast::daemon {

struct BrokerOptions {
  Arena arena;
  Config config;
  std::uint64_t former_count = 0;  // daemons that began here before
};

class Broker final {
 public:
  Broker(const BrokerOptions& options, Log& log, Dispatcher& dispatcher, Listener& listener,
         Regions regions, DescriptorStore& store, Errands& errands, Disposal& disposal);
  ~Broker();
  Broker(const Broker&) = delete;
  Broker& operator=(const Broker&) = delete;

  /// A new life, in memory that is all zero. Errors: as DescriptorStore::put.
  [[nodiscard]] Result<void> found(std::uint64_t incarnation);
  /// Goes on with a former life, see Recovery. Errors: layout_mismatch, store_damaged,
  /// os_failure.
  [[nodiscard]] Result<void> resume();
  /// Begins to serve. Errors: os_failure.
  [[nodiscard]] Result<void> start();
  /// Serves what the dispatcher has found, each user a share of it; what remains is served next time.
  void serve_waiting();
  /// What is to be done now and then; call it after at most due_ms() (-1: nothing is due).
  void tick();
  int due_ms() const noexcept;
  /// The one in force: a former life's, whatever the options say.
  const Arena& arena() const noexcept { return options_.arena; }

 private:
  void accept_some();
  /// Nobody is accepted until the next look around: there is no descriptor.
  void pause_listening();
  void accept(PacketSocket socket);
  /// Takes one waiting connection although no descriptor is left, and says why it is refused.
  void turn_away();
  void fill_request_table();
  /// Serves one connection in its user's time slice. Returns how many packets there were; nothing: it is gone.
  std::optional<unsigned> take_turn(PeerId id, const TimeSlice& slice);
  /// Returns how many packets there were.
  unsigned read_packets(PeerId id, const TimeSlice& slice);
  /// Looks at the next packet of a connection that descriptors may have come into. False: it is not to be
  /// received here, and has been dealt with.
  bool may_receive(Peer& peer, std::span<std::byte> buffer);
  void close_connection(PacketSocket socket, std::uint32_t uid);
  /// A window comes with a descriptor, which is received elsewhere.
  void receive_window(Peer& peer);
  void serve_window(PeerId id, std::uint64_t ticket, Disposal::Received& received);
  void look_around(std::uint64_t now);
  void watch_holds();
  void watch_letting_go();
  void announce_what_waits();
  void on_ended(ClientIndex client);
  BrokerOptions options_;
  Log& log_;
  Dispatcher& dispatcher_;
  Listener& listener_;
  DescriptorStore& store_;
  Errands& errands_;
  Disposal& disposal_;
  Refusals refusals_;
  ConnectionTable connections_;
  PeerOutput output_;
  std::shared_ptr<char> here_ = std::make_shared<char>();  // what answers of errands look for
  Regions regions_;
  Registry registry_;
  AccessControl access_;
  AddressPlan plan_;
  Obstacles obstacles_;
  Doorbells doorbells_;
  Membership membership_;
  Admission admission_;
  AddressConflicts conflicts_;
  ReapingQueue reaping_;
  RegionLook region_look_;
  ClientTermination termination_;
  RequestScheduler scheduler_;
  UserNamespaces namespaces_;
  DumpCollector collector_;
  ObserverAnswers answers_;
  ObserverRequests observer_requests_;
  HoldWatch hold_watch_;
  LetGoWatch let_go_watch_;
  RefusalReport refusal_report_;
  RequestServer server_;
  HelloRequests hello_requests_;
  RejoinRequests rejoin_requests_;
  WindowRequests window_requests_;
  ExecutorRequests executor_requests_;
  EndpointRequests endpoint_requests_;
  AcknowledgementRequests acknowledgement_requests_;
  std::uint64_t looked_ms_ = 0;    // when tick() last had a look
  std::uint64_t watched_ms_ = 0;   // the same, at what is held and what is let go of
  UniqueFd spare_;                 // given up for a moment when no descriptor is left
  Dispatcher::Token listening_ = 0;
  bool listens_ = true;
  bool knocks_ = false;  // somebody wants to connect
};

}  // namespace agnocast::daemon
