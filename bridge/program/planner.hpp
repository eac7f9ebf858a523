// SPDX-License-Identifier: Apache-2.0
//
// Planner: decides when to plan, and from what. The plans themselves are pure: routes.hpp,
// service_plan.hpp.
//
//   endpoints of this host or rules changed             plan at once
//   DDS changed                                         plan when PlanPace allows
//   agnocastd did not answer, or a table was full       plan again after a while
//
// A writer that came and went since the last plan may have matched an existing DDS reader: it
// still gets its publisher here, which then lingers. So a plan with such writers precedes the plan
// without them.
//
// One thread, run()'s, except for set_rules().
#pragma once

#include <agnocast/graph.hpp>
#include <bridge/common/linger.hpp>
#include <bridge/common/message_types.hpp>
#include <bridge/common/refusals.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/plan/plan_pace.hpp>
#include <bridge/plan/routes.hpp>
#include <bridge/plan/service_plan.hpp>
#include <bridge/program/marker.hpp>

#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <span>
#include <vector>

namespace agnocast::bridge {

class Planner {
 public:
  /// The topics and directions: the part that a reload of the configuration may change.
  struct Rules {
    std::vector<Rule> list;
    Direction otherwise = Direction::both;
    bool announce = true;
  };
  struct Plans {
    Plan topics;
    ServicePlan services;
    // Another bridge of the domain is active now and serves our routes: nothing lingers.
    bool ends_all = false;
  };
  struct CarriedOut {
    bool is_whole = true;            // false: agnocastd did not answer, retry the rest later
    std::optional<Time> again = {};  // when to retry what did not fit
  };
  using CarryOut = std::function<CarriedOut(const Plans&)>;
  using HasRemotePublisher = std::function<bool(const Guid& writer)>;

  /// All references must outlive it. `has_remote_publisher` tells if a remote writer has a
  /// publisher here.
  Planner(std::uint32_t domain, Rules rules, Marker& marker, MessageTypes& types, PlanPace& pace,
          Refusals& refusals, HasRemotePublisher has_remote_publisher);

  /// Replaces the rules, once renew_rules() has been called. Any thread.
  void set_rules(Rules rules);
  /// Returns whether the rules were replaced.
  bool renew_rules();
  /// Takes the endpoints of this host. Returns true if they come from another agnocastd.
  bool renew_local(GraphSnapshot local);
  /// Remembers changes in DDS for the next plan.
  void note(const std::vector<RemoteChange>& changes);
  /// Other participants changed something else that a plan carries out.
  void note_change() noexcept { pace_.changed(); }

  /// Returns whether to plan although nothing changes on this host.
  bool is_due(Time now) const;
  /// Returns when that will be; nothing if no plan is pending.
  std::optional<Time> due() const { return earliest(again_, pace_.due()); }
  /// Plans for `remotes` and carries it out. Returns false if agnocastd is absent: retry later.
  bool plan(const DdsParticipant::Remotes& remotes, const CarryOut& carry_out);

  std::span<const EndpointInfo> local() const noexcept { return local_.endpoints; }
  /// The topics and services that the newest plan does not bridge.
  const std::vector<Unbridged>& unbridged() const noexcept { return unbridged_; }

 private:
  /// Returns whether everything was planned and made; if not, unplaced messages wait for the next
  /// plan.
  bool plan_once(const DdsParticipant::Remotes& remotes, const CarryOut& carry_out);
  Situation situation(const DdsParticipant::Remotes& remotes);

  const std::uint32_t domain_;
  Marker& marker_;
  MessageTypes& types_;
  PlanPace& pace_;
  Refusals& refusals_;
  const HasRemotePublisher has_remote_publisher_;
  Rules rules_;
  GraphSnapshot local_;
  std::vector<Remote> gone_writers_;  // since the newest complete plan, without a publisher here
  std::optional<Time> again_;         // plan again at this time
  std::vector<Unbridged> unbridged_;
  std::mutex next_mutex_;            // guards next_rules_
  std::optional<Rules> next_rules_;  // not in force yet
};

}  // namespace agnocast::bridge
