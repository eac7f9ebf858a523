// SPDX-License-Identifier: Apache-2.0
//
// Broker: the composition root of agnocastd. It builds and owns everything below, and says in which
// order it has its time slice. What happens when, and where:
//
//   somebody wants to connect   Acceptor: accepts, identifies, watches connection and process
//   connection readable         RequestScheduler, when its user has a time slice → PacketReader → RequestServer
//                               → the handler that RequestTable names: *_requests.hpp
//   connection or process ended ClientTermination: keeps the client (the process lives), or reaps
//   it an errand has ended         the request that was parked for it goes on (RequestScheduler)
//   time passes                 tick(): ReapingQueue, ObserverAnswers, and look_around() for what
//   is due started again               Recovery
//
// What handlers share: Admission (quotas), AccessControl (rules), AddressConflicts (heaps that
// collide), PeerOutput (what is sent), ConnectionTable (who is there). None of them knows Broker.
//
// One thread. Calls that may take as long as a client likes are made in others (errands.hpp,
// disposal.hpp), and so is the freeing of memory (closer.hpp). The order of things inside one event
// is the protocol's; between events everything is consistent, so the daemon may be killed at any
// time.
#pragma once

#include <base/text/log.hpp>
#include <daemon/admission/access_control.hpp>
#include <daemon/admission/address_conflicts.hpp>
#include <daemon/admission/admission.hpp>
#include <daemon/admission/refusal_report.hpp>
#include <daemon/config/config.hpp>
#include <daemon/death/client_termination.hpp>
#include <daemon/death/hold_watch.hpp>
#include <daemon/death/reaping_queue.hpp>
#include <daemon/death/region_look.hpp>
#include <daemon/death/unmap_watch.hpp>
#include <daemon/lifecycle/endpoint_manager.hpp>
#include <daemon/lifecycle/regions.hpp>
#include <daemon/observers/dump_collector.hpp>
#include <daemon/observers/observer_answers.hpp>
#include <daemon/observers/observer_requests.hpp>
#include <daemon/requests/acknowledgement_requests.hpp>
#include <daemon/requests/endpoint_requests.hpp>
#include <daemon/requests/executor_requests.hpp>
#include <daemon/requests/hello_requests.hpp>
#include <daemon/requests/reader_reports.hpp>
#include <daemon/requests/rejoin_requests.hpp>
#include <daemon/requests/window_requests.hpp>
#include <daemon/serving/acceptor.hpp>
#include <daemon/serving/packet_reader.hpp>
#include <daemon/serving/request_scheduler.hpp>
#include <daemon/serving/request_server.hpp>
#include <daemon/serving/user_namespaces.hpp>
#include <daemon/state/address_plan.hpp>
#include <daemon/state/obstacles.hpp>
#include <daemon/state/refusals.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/descriptor_store.hpp>
#include <daemon/transport/dispatcher.hpp>
#include <daemon/transport/disposal.hpp>
#include <daemon/transport/doorbells.hpp>
#include <daemon/transport/errands.hpp>
#include <daemon/transport/listener.hpp>
#include <daemon/transport/peer_output.hpp>

#include <cstdint>

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
  Broker(const Broker&) = delete;
  Broker& operator=(const Broker&) = delete;

  /// A new life, in memory that is all zero. Errors: as DescriptorStore::put.
  [[nodiscard]] Result<void> format(std::uint64_t incarnation);
  /// Goes on with a previous run, see Recovery. Errors: layout_mismatch, store_damaged,
  /// os_failure.
  [[nodiscard]] Result<void> resume();
  /// Begins to serve. Errors: os_failure.
  [[nodiscard]] Result<void> start();
  /// Serves what the dispatcher has found, each user a share of it; what remains is served next
  /// time.
  void serve_waiting();
  /// What is to be done now and then; call it after at most due_ms() (-1: nothing is due).
  void tick();
  int due_ms() const noexcept;
  /// The one in force: a previous run's, whatever the options say.
  const Arena& arena() const noexcept { return options_.arena; }

 private:
  void fill_request_table();
  /// What is to be done a few times a second, however many events there are.
  void look_around(std::uint64_t now);
  /// Revoke processes that hold more than they may, and that do not let go.
  void watch_holds();
  void watch_letting_go();
  void announce_what_waits();
  /// The place of a process is free, and so are its addresses.
  void free_client(ClientIndex client);

  BrokerOptions options_;
  Log& log_;
  Dispatcher& dispatcher_;
  Listener& listener_;
  DescriptorStore& store_;
  Refusals refusals_;
  ConnectionTable connections_;
  PeerOutput output_;
  Regions regions_;
  Registry registry_;
  AccessControl access_;
  AddressPlan plan_;
  Obstacles obstacles_;
  Doorbells doorbells_;
  EndpointManager endpoint_manager_;
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
  UnmapWatch unmap_watch_;
  ReaderReports readers_;
  RefusalReport refusal_report_;
  RequestServer server_;
  HelloRequests hello_requests_;
  RejoinRequests rejoin_requests_;
  WindowRequests window_requests_;
  ExecutorRequests executor_requests_;
  EndpointRequests endpoint_requests_;
  AcknowledgementRequests acknowledgement_requests_;
  PacketReader reader_;
  Acceptor acceptor_;
  std::uint64_t looked_ms_ = 0;   // when tick() last had a look
  std::uint64_t watched_ms_ = 0;  // the same, at what is held and what is let go of
};

}  // namespace agnocast::daemon
