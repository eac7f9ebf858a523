// SPDX-License-Identifier: Apache-2.0
//
// Planner: when the bridge plans, and from what. The plans themselves are pure: routes.hpp, service_plan.hpp.
//
//   endpoints of this host, rules     have changed: at once
//   DDS                               has changed: as PlanPace says
//   agnocastd did not answer, or there was no place: again after a while
//
// A writer that came and went since the last look may have been matched with an inlet that was there already: it gets its
// source, which then lingers. So there is a plan with those that are gone before the one without them.
//
// One thread, run()'s, but for set_rules().
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
  /// Which topics, which way: what a configuration that is read again may change.
  struct Rules {
    std::vector<Rule> list;
    Direction otherwise = Direction::both;
    bool announce = true;
  };
  struct Plans {
    Plan topics;
    ServicePlan services;
    // Another bridge of the domain is active now, and has what we had: nothing lingers.
    bool ends_all = false;
  };
  struct CarriedOut {
    bool is_whole = true;            // false: agnocastd did not answer, what is left is for later
    std::optional<Time> again = {};  // then there may be room for what there was none for
  };
  using CarryOut = std::function<CarriedOut(const Plans&)>;
  using HasSource = std::function<bool(const Guid& writer)>;

  /// All references must outlive it. `has_source` says whether a remote writer has its source.
  Planner(std::uint32_t domain, Rules rules, Marker& marker, MessageTypes& types, PlanPace& pace,
          Refusals& refusals, HasSource has_source);

  /// From now on these rules hold, when renew_rules() has seen them. Any thread.
  void set_rules(Rules rules);
  /// Whether there are others than before.
  bool renew_rules();
  /// What there is on this host now. True if it is another agnocastd that says so.
  bool renew_local(GraphSnapshot local);
  /// Remembers what changed in DDS, for the next plan.
  void note(const std::vector<RemoteChange>& changes);

  /// Whether something is to be planned, if nothing changes on this host.
  bool is_due(Time now) const;
  /// When it will be; never, if nothing is owed.
  std::optional<Time> due() const { return earliest(again_, pace_.due()); }
  /// Plans for these and has it carried out. False if agnocastd is away: it is for later.
  bool plan(const DdsParticipant::Remotes& remotes, const CarryOut& carry_out);

  std::span<const EndpointInfo> local() const noexcept { return local_.endpoints; }
  /// Of the newest plan.
  const std::vector<Unbridged>& unbridged() const noexcept { return unbridged_; }

 private:
  /// Whether all of it could be planned and made; if not, what comes of writers without a source waits for the next one.
  bool plan_once(const DdsParticipant::Remotes& remotes, const CarryOut& carry_out);
  Situation situation(const DdsParticipant::Remotes& remotes);

  const std::uint32_t domain_;
  Marker& marker_;
  MessageTypes& types_;
  PlanPace& pace_;
  Refusals& refusals_;
  const HasSource has_source_;
  Rules rules_;
  GraphSnapshot local_;
  std::vector<Remote> gone_writers_;  // since the newest whole plan, without a source
  std::optional<Time> again_;         // then, whatever happens until then
  std::vector<Unbridged> unbridged_;
  std::mutex next_mutex_;            // of the next one
  std::optional<Rules> next_rules_;  // not in force yet
};

}  // namespace agnocast::bridge
