// SPDX-License-Identifier: Apache-2.0
//
// Bridge: what agnocast-bridge is made of, and the loop that turns it.
//
//   watch thread     sleeps until endpoints of this host change ──────────┐
//   run()            sleeps until DDS or the graph has something: plans,  ◀┘  has the routes make and end endpoints;
//                    has what inlets received published
//   lanes            (nodes' threads, the library's) outward_routes.hpp
//   Cyclone's        inward_routes.hpp
//
//   HostWatch, Marker ──▶ Planner ──▶ OutwardRoutes, InwardRoutes, ServiceRoutes ──▶ DiscoveryInfo, StatusCollector
//
// Idle, none of our threads wakes. What goes wrong with one message or one endpoint is counted and logged, and the others
// go on.
#pragma once

#include <bridge/common/linger.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/message_types.hpp>
#include <bridge/common/reaper.hpp>
#include <bridge/common/refusals.hpp>
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
  std::uint32_t domain = 0;  ///< of DDS, and of the endpoints of this host that are bridged
  std::vector<Rule> rules;
  std::vector<std::string> type_paths;  ///< see try_find_message_type
  RosGraph::Speak speak = RosGraph::Speak::detect;
  Direction otherwise = Direction::both;  ///< of topics that no rule speaks of
  bool announce = true;  ///< publishers that nobody in DDS reads have a writer there as well
  /// Called by run() at least that often, for who watches whether it turns; 0: never.
  std::chrono::nanoseconds alive_interval{0};
  std::function<void()> alive = {};
};

class Bridge {
 public:
  /// Joins the DDS domain. This process must have the same domain in ROS_DOMAIN_ID. `log` must outlive it.
  [[nodiscard]] static DdsResult<std::unique_ptr<Bridge>> create(BridgeOptions options,
                                                                 const Log& log);
  ~Bridge();
  Bridge(const Bridge&) = delete;
  Bridge& operator=(const Bridge&) = delete;

  /// Until stop(). Errors: what Cyclone DDS refused of the participant itself. Throws std::bad_alloc when there is no
  /// memory to plan with; then it can only be destroyed.
  [[nodiscard]] DdsResult<void> run();
  /// Any thread. run() returns soon.
  void stop() noexcept;
  /// From now on these rules hold; what another one had made otherwise is made anew. Any thread.
  void set_rules(std::vector<Rule> rules, Direction otherwise, bool announce);
  /// What there is now, as run() sees it; nothing when it does not say so for `patience`. One thread, not run()'s.
  std::optional<BridgeStatus> status(std::chrono::milliseconds patience);

 private:
  Bridge(BridgeOptions options, const Log& log, OutwardRoutes::Lanes lanes,
         std::unique_ptr<DdsParticipant> participant, std::unique_ptr<RosGraph> graph);
  /// What a turn of run() does with what it was woken for.
  void move(const DdsParticipant::Ready& ready);
  /// Whether there is something new on this host.
  bool renew_local();
  void take_from(DdsReader& inlet);
  void plan();
  Planner::CarriedOut carry_out(const Planner::Plans& plans);
  /// How long run() may sleep.
  std::chrono::nanoseconds tidy();

  const std::chrono::nanoseconds alive_interval_;
  const std::function<void()> alive_;
  const OutwardRoutes::Lanes lanes_;
  const std::unique_ptr<DdsParticipant> participant_;
  const std::unique_ptr<RosGraph> ros_graph_;
  MessageTypes types_;
  Refusals refusals_;
  Reaper reaper_;
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
