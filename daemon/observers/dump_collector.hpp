// SPDX-License-Identifier: Apache-2.0
//
// DumpCollector: collects the facts of a dump that are not in the tables from all parts of the
// daemon.
#pragma once

#include <base/text/log.hpp>
#include <daemon/admission/admission.hpp>
#include <daemon/config/config.hpp>
#include <daemon/lifecycle/regions.hpp>
#include <daemon/observers/dump.hpp>
#include <daemon/state/address_plan.hpp>
#include <daemon/state/obstacles.hpp>
#include <daemon/state/refusals.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/descriptor_store.hpp>
#include <daemon/transport/doorbells.hpp>

namespace agnocast::daemon {

/// The parts of the daemon that the facts come from.
struct DumpSources {
  const Config& config;
  const Arena& arena;
  const AddressPlan& plan;
  const Registry& registry;
  const Regions& regions;
  const Doorbells& doorbells;
  const Obstacles& obstacles;
  const Admission& admission;
  const Refusals& refusals;
  const DescriptorStore& store;
  const ConnectionTable& connections;
  const Log& log;
};

class DumpCollector {
 public:
  explicit DumpCollector(const DumpSources& sources) noexcept : from_(sources) {}

  /// Returns the facts of this moment, except answers_ahead of users; those of processes are
  /// looked up when the dump is made.
  DumpFacts collect() const;

 private:
  DumpFacts::Process process_of(ClientIndex client, std::uint64_t now_ns) const;
  void collect_daemon(abi::wire::DumpDaemon& daemon, std::uint64_t now_ns) const;

  DumpSources from_;
};

}  // namespace agnocast::daemon
