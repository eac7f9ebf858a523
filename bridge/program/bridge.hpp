// SPDX-License-Identifier: Apache-2.0
//
// Bridge: carries out what routes.hpp plans, and moves messages.
//
//   graph thread     sleeps until endpoints of this host change ──────────┐
//   run()            sleeps until DDS or the graph has something: plans,  ◀┘  makes and ends endpoints;
//                    takes what inlets received, publishes it by the sources
//   lanes            (nodes' threads, the library's) taps' messages ──▶ writers of their outlets; a topic's
//                    large messages hold up the other topics of its lane only
//   Cyclone's        fragments ──▶ messages in the shared heap (decoders of the inlets)
//
// Outward a message is written from shared memory straight into the DDS sample, inward it is read from the
// fragments straight into shared memory. Idle, none of our threads wakes.
//
// What goes wrong with one message or one endpoint is counted and logged, and the others go on. A message that
// keep-all holds up (a subscription of this host has not read enough) waits here for its turn, within bounds.
//
// Two bridges of one domain at one daemon would double every message. So each has an endpoint that the others see, the
// marker, before anything else, and has routes only if no older marker is there: a snapshot with its own has all that are older.
#pragma once

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>
#include <agnocast/graph.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/status.hpp>
#include <bridge/dds/ros_graph.hpp>
#include <bridge/inward/inward_routes.hpp>
#include <bridge/outward/outward_routes.hpp>
#include <bridge/plan/plan_pace.hpp>
#include <bridge/plan/routes.hpp>
#include <bridge/services/service_routes.hpp>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
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
  /// Which topics, which way: what a configuration that is read again may change.
  struct Rules {
    std::vector<Rule> list;
    Direction otherwise = Direction::both;
    bool announce = true;
  };
  Bridge(BridgeOptions options, const Log& log, OutwardRoutes::Lanes lanes,
         std::unique_ptr<DdsParticipant> participant, std::unique_ptr<RosGraph> graph);
  void watch_graph();
  /// Whether agnocastd answers, as a thread has heard it; said when it changes.
  void daemon_is(bool there, const std::string& why);
  /// What all bridges of this domain can see of this one; false if it is not there yet.
  bool show_oneself();
  /// What is planned: nothing while another bridge of the domain was here first.
  enum class Role : std::uint8_t { unknown, active, standby };
  Role find_role();
  void stand_by();
  bool renew_local();
  bool renew_rules();
  void answer_status();
  BridgeStatus look() const;
  /// How long run() may sleep.
  std::chrono::nanoseconds tidy();
  /// Remembers what changed in DDS, for the next plan.
  void note(const std::vector<RemoteChange>& changes);
  void look_around();
  /// Whether all of it could be planned and made; if not, what comes of writers without a source waits for the next one.
  bool plan_and_apply(const DdsParticipant::Remotes& remotes);
  bool gives_up(Errc why);
  void tell_ros(const Plan& plan);
  void take_from(DdsReader& inlet);
  void tell_limits();

  const BridgeOptions options_;
  const Log& log_;
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
  bool is_cut_short_ = false;          // the newest plan: agnocastd did not answer
  std::vector<Remote> gone_writers_;   // since the newest whole plan, without a source
  std::uint64_t limits_told_ = 0;      // refusals when it was said last
  Seldom tells_limits_;
  std::optional<Time> plan_again_;  // then, whatever happens until then
  Rules rules_;
  std::vector<Unbridged> unbridged_;          // of the newest plan
  std::uint64_t discovery_info_refused_ = 0;  // when it was said last
  Seldom tells_discovery_info_;
  const std::uint64_t since_ns_ = monotonic_ns();

  Graph graph_;
  std::mutex mutex_;                     // of the next four
  std::optional<GraphSnapshot> latest_;  // not looked at yet
  std::optional<Rules> next_rules_;      // not in force yet
  bool is_asked_ = false;                // for the status
  std::optional<BridgeStatus> answer_;
  std::condition_variable answered_;
  enum class Daemon : std::uint8_t { unknown, there, away };
  std::atomic<Daemon> daemon_{Daemon::unknown};
  GraphSnapshot local_;
  const std::string marker_node_;  // a name that no other bridge has
  std::unique_ptr<Node> marker_lane_;
  GenericSubscription::SharedPtr marker_;
  struct NoMarker {
    Errc code;
    std::string why;
  };
  std::optional<NoMarker> no_marker_;         // why there is none
  std::optional<std::uint32_t> standby_for_;  // the pid of the bridge that is active
  std::atomic<bool> stops_{false};
  std::mutex pause_mutex_;
  std::condition_variable paused_;
  std::atomic<bool> is_revoked_{false};
  std::exception_ptr failed_;  // graph_thread_, which has ended
  std::thread graph_thread_;
};

}  // namespace agnocast::bridge
