// SPDX-License-Identifier: Apache-2.0
//
// Bridge: the parts of agnocast-bridge, and its main loop.
//
//   watch thread     sleeps until endpoints of this host change ──────────┐
//   run()            sleeps until DDS or the graph has something: plans,  ◀┘
//                    lets the routes create and end endpoints, and publish received messages
//   lanes            (a thread each) outward_routes.hpp
//   Cyclone's        inward_routes.hpp
//
//   HostWatch, Marker ──▶ Planner ──▶ OutwardRoutes, InwardRoutes, ServiceRoutes ──▶ DiscoveryInfo, StatusCollector
//
// While nothing happens, none of our threads wakes. A failure of one message or endpoint is
// counted and logged, and the others continue.
#pragma once

#include <bridge/common/lane.hpp>
#include <bridge/common/linger.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/message_types.hpp>
#include <bridge/common/refusals.hpp>
#include <bridge/common/slow_deleter.hpp>
#include <bridge/common/status.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/dds/ros_graph.hpp>
#include <bridge/inward/inward_routes.hpp>
#include <bridge/outward/outward_routes.hpp>
#include <bridge/plan/plan_pace.hpp>
#include <bridge/plan/routes.hpp>
#include <bridge/program/discovery_info.hpp>
#include <bridge/program/host_watch.hpp>
#include <bridge/program/limits_log.hpp>
#include <bridge/program/marker.hpp>
#include <bridge/program/planner.hpp>
#include <bridge/program/status_collector.hpp>
#include <bridge/services/service_routes.hpp>

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace agnocast::bridge {

struct BridgeOptions {
  std::uint32_t domain = 0;  ///< of DDS and of the bridged endpoints of this host
  std::vector<Rule> rules;
  std::vector<std::string> type_paths;  ///< see try_find_message_type
  RosGraph::Speak speak = RosGraph::Speak::detect;
  Direction otherwise = Direction::both;  ///< for topics that no rule matches
  bool announce = true;  ///< give publishers without a reader in DDS a DDS writer as well
  /// run() calls `alive` at least this often, for a watchdog; 0: never.
  std::chrono::nanoseconds alive_interval{0};
  std::function<void()> alive = {};
};

class Bridge {
 public:
  /// Joins the DDS domain, which must be that of ROS_DOMAIN_ID. `log` must outlive the bridge.
  [[nodiscard]] static DdsResult<std::unique_ptr<Bridge>> create(BridgeOptions options,
                                                                 const Log& log);
  ~Bridge();
  Bridge(const Bridge&) = delete;
  Bridge& operator=(const Bridge&) = delete;

  /// Runs until stop(). Errors: failures of the DDS participant itself. Throws std::bad_alloc if
  /// there is no memory to plan with; then the bridge can only be destroyed.
  [[nodiscard]] DdsResult<void> run();
  /// Makes run() return soon. Any thread.
  void stop() noexcept;
  /// Replaces the rules; routes that the old rules made differently are made again. Any thread.
  void set_rules(std::vector<Rule> rules, Direction otherwise, bool announce);
  /// Returns run()'s status; nothing if it does not answer within `patience`. One thread, not
  /// run()'s.
  std::optional<BridgeStatus> status(std::chrono::milliseconds patience);

 private:
  Bridge(BridgeOptions options, const Log& log, Lanes lanes,
         std::unique_ptr<DdsParticipant> participant, std::unique_ptr<RosGraph> graph);
  /// Handles the events that woke run().
  void move(const DdsParticipant::Ready& ready);
  /// Returns whether the endpoints of this host have changed.
  bool renew_local();
  void take_from(DdsReader& dds_reader);
  void plan();
  Planner::CarriedOut carry_out(const Planner::Plans& plans);
  /// Ends what is over, and returns how long run() may sleep.
  std::chrono::nanoseconds tidy();

  const std::chrono::nanoseconds alive_interval_;
  const std::function<void()> alive_;
  const Lanes lanes_;
  const std::unique_ptr<DdsParticipant> participant_;
  const std::unique_ptr<RosGraph> ros_graph_;
  MessageTypes types_;
  Refusals refusals_;
  SlowDeleter deleter_;
  PlanPace pace_;
  OutwardRoutes outward_;
  InwardRoutes inward_;
  ServiceRoutes services_;
  HostWatch watch_;
  Marker marker_;
  Planner planner_;
  DiscoveryInfo discovery_info_;
  LimitsLog limits_log_;
  StatusCollector status_;
};

}  // namespace agnocast::bridge
