// SPDX-License-Identifier: Apache-2.0
//
// StatusCollector: collects the state of all parts of the bridge at one moment (status.hpp).
// Another thread asks; run()'s thread, which owns all parts, answers.
#pragma once

#include <base/clock.hpp>
#include <bridge/common/refusals.hpp>
#include <bridge/common/status.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/dds/ros_graph.hpp>
#include <bridge/inward/inward_routes.hpp>
#include <bridge/outward/outward_routes.hpp>
#include <bridge/program/host_watch.hpp>
#include <bridge/program/marker.hpp>
#include <bridge/program/planner.hpp>
#include <bridge/services/service_routes.hpp>

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <optional>

namespace agnocast::bridge {

class StatusCollector {
 public:
  /// The parts that it reads.
  struct Parts {
    DdsParticipant& participant;
    const RosGraph& ros_graph;
    const OutwardRoutes& outward;
    const InwardRoutes& inward;
    const ServiceRoutes& services;
    const HostWatch& watch;
    const Marker& marker;
    const Planner& planner;
    const Refusals& refusals;
  };
  /// All parts must outlive it.
  StatusCollector(std::uint32_t domain, const Parts& parts) : domain_(domain), parts_(parts) {}

  /// Returns run()'s status; nothing if it does not answer within `patience`. One other thread.
  std::optional<BridgeStatus> ask(std::chrono::milliseconds patience);
  /// Answers a pending request, if there is one. run()'s thread.
  void answer();

 private:
  BridgeStatus look() const;

  const std::uint32_t domain_;
  const Parts parts_;
  const std::uint64_t since_ns_ = monotonic_ns();
  std::mutex mutex_;  // guards the next two
  bool is_asked_ = false;
  std::optional<BridgeStatus> answer_;
  std::condition_variable answered_;
};

}  // namespace agnocast::bridge
