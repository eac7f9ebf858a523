// SPDX-License-Identifier: Apache-2.0
//
// Recovery: continues a previous run. docs/control-plane.md, "Restart".
//
// Tables, board, memory, doorbells and the identity of every process are as before; connections
// are not. So each living process counts as one without a connection until it sends rejoin, and
// recorded changes that were not applied, sent or rung are repeated:
//
//     redo the pending change → repair the board from the tables → take memory, doorbells and pidfds
//     → remove what belongs to no living record → handle deaths that happened meanwhile, finish unfinished
//     reaps → carry out what follows from the last records → move every epoch, ring every doorbell
//
// Each step may be repeated: a daemon that dies in here is started again and begins here.
#pragma once

#include <base/descriptors/pidfd.hpp>
#include <base/text/log.hpp>
#include <daemon/death/client_termination.hpp>
#include <daemon/lifecycle/endpoint_manager.hpp>
#include <daemon/lifecycle/regions.hpp>
#include <daemon/serving/request_scheduler.hpp>
#include <daemon/serving/user_namespaces.hpp>
#include <daemon/state/address_plan.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/descriptor_store.hpp>
#include <daemon/transport/dispatcher.hpp>
#include <daemon/transport/doorbells.hpp>
#include <journal/cases.hpp>

#include <cstdint>
#include <vector>

namespace agnocast::daemon {

/// The parts of the daemon that continue a previous run.
struct RecoveredParts {
  const Arena& arena;
  AddressPlan& plan;
  Registry& registry;
  Regions& regions;
  Doorbells& doorbells;
  EndpointManager& endpoint_manager;
  DescriptorStore& store;
  Dispatcher& dispatcher;
  ConnectionTable& connections;
  RequestScheduler& scheduler;
  UserNamespaces& namespaces;
  ClientTermination& termination;
  Log& log;
};

class Recovery {
 public:
  explicit Recovery(const RecoveredParts& parts) noexcept : of_(parts) {}

  /// Recovers. Call once, after opening the registry and before serving. Errors: store_damaged,
  /// os_failure.
  [[nodiscard]] Result<void> run();

 private:
  [[nodiscard]] Result<journal::FoundDecision> adopt_client(ClientIndex client,
                                                            std::uint64_t& lost);
  void back_endpoints(ClientIndex client);
  [[nodiscard]] Result<void> watch(ClientIndex client, Pidfd process);
  std::uint64_t reap_while_away(const std::vector<ClientIndex>& ended);

  RecoveredParts of_;
};

}  // namespace agnocast::daemon
