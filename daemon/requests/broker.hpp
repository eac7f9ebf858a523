// SPDX-License-Identifier: Apache-2.0
//
// Broker: the composition root of agnocastd. It builds and owns all other parts, and decides in
// which order they have their time slices. What happens when, and where:
//
//   a process connects          Acceptor: accepts, identifies, watches connection and process
//   connection readable         RequestScheduler, in its user's time slice → PacketReader
//                               → RequestServer → the handler of RequestTable: *_requests.hpp
//   connection or process ended ClientTermination: keeps the client if its process lives, or reaps
//   an errand has ended         RequestScheduler: the parked request continues
//   time passes                 tick(): ReapingQueue, ThreadRequests, GraphRequests,
//                               ObserverAnswers, periodic look_around()
//   started again               Recovery
//
// Handlers share Admission (quotas), AccessControl (rules), AddressConflicts (heaps that collide),
// PeerOutput (sending) and ConnectionTable (connections). None of them knows Broker.
//
// One thread. Other threads make calls that may take as long as a client likes (errands.hpp,
// disposal.hpp) and free memory (closer.hpp). The protocol gives the order of steps inside one
// event; between events everything is consistent, so the daemon may be killed at any time.
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
#include <daemon/observers/graph_requests.hpp>
#include <daemon/observers/observer_answers.hpp>
#include <daemon/observers/observer_requests.hpp>
#include <daemon/requests/acknowledgement_requests.hpp>
#include <daemon/requests/endpoint_requests.hpp>
#include <daemon/requests/hello_requests.hpp>
#include <daemon/requests/reader_reports.hpp>
#include <daemon/requests/rejoin_requests.hpp>
#include <daemon/requests/thread_requests.hpp>
#include <daemon/requests/wait_set_requests.hpp>
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

  /// Begins a new incarnation, in memory that is all zero. Errors: as DescriptorStore::put.
  [[nodiscard]] Result<void> format(std::uint64_t incarnation);
  /// Continues a previous run, see Recovery. Errors: layout_mismatch, store_damaged, os_failure.
  [[nodiscard]] Result<void> resume();
  /// Begins to serve. Errors: os_failure.
  [[nodiscard]] Result<void> start();
  /// Serves each user's share of the requests that the dispatcher has found; the rest comes next.
  void serve_waiting();
  /// Does periodic work; call it after at most due_ms() (-1: nothing is due).
  void tick();
  int due_ms() const noexcept;
  /// Returns the arena in force: the previous run's, whatever the options say.
  const Arena& arena() const noexcept { return options_.arena; }
  // For tests.
  const Registry& registry() const noexcept { return registry_; }
  const AddressPlan& plan() const noexcept { return plan_; }
  Registry::Memory tables() const noexcept { return regions_.memory(); }

 private:
  void fill_request_table();
  /// Does the work that is due a few times a second, however many events there are.
  void look_around(std::uint64_t now);
  /// Revoke processes that hold more than they may, and those that do not unmap.
  void watch_holds();
  void watch_unmapping();
  void announce_what_waits();
  /// Frees the memory and the addresses of a process whose place is free.
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
  GraphRequests graph_requests_;
  HoldWatch hold_watch_;
  UnmapWatch unmap_watch_;
  ReaderReports readers_;
  RefusalReport refusal_report_;
  RequestServer server_;
  HelloRequests hello_requests_;
  RejoinRequests rejoin_requests_;
  WindowRequests window_requests_;
  WaitSetRequests wait_set_requests_;
  EndpointRequests endpoint_requests_;
  AcknowledgementRequests acknowledgement_requests_;
  ThreadRequests thread_requests_;
  PacketReader reader_;
  Acceptor acceptor_;
  std::uint64_t looked_ms_ = 0;   // when look_around() last ran
  std::uint64_t watched_ms_ = 0;  // when watch_holds() and watch_unmapping() last ran
};

}  // namespace agnocast::daemon
