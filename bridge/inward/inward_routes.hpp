// SPDX-License-Identifier: Apache-2.0
//
// InwardRoutes: carries out what routes.hpp plans from DDS to this host.
//
//   Cyclone's threads   fragments ──▶ messages in the shared heap (decoders of the inlets)
//   run()               takes what inlets received ──▶ publishes it by the sources of their writers
//
// A message is read from the fragments straight into shared memory: the publisher that it is for is known only when it is
// taken. One whose writer has no source yet waits for the plan that is owed, within bounds.
//
// Everything but decoders is run()'s thread.
#pragma once

#include <agnocast/agnocast.hpp>
#include <bridge/common/linger.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/message_types.hpp>
#include <bridge/common/reaper.hpp>
#include <bridge/common/refusals.hpp>
#include <bridge/common/status.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/dds/ros_graph.hpp>
#include <bridge/inward/sources.hpp>
#include <bridge/plan/plan_pace.hpp>
#include <bridge/plan/routes.hpp>

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

namespace agnocast::bridge {

class InwardRoutes {
 public:
  /// All must outlive it. `node` has the publishers; `pace` says whether a plan is owed, which may know writers that have
  /// no source yet.
  InwardRoutes(DdsParticipant& participant, Node& node, const MessageTypes& types,
               const PlanPace& pace, const Log& log, Reaper& reaper, Refusals& refusals)
      : participant_(participant),
        types_(types),
        pace_(pace),
        log_(log),
        refusals_(refusals),
        sources_(node, types, participant.limits(), reaper, log) {}

  /// Ends inlets that the plan has with another QoS, which cannot change while they live.
  void end_changed(const Plan& plan);
  struct Applied {
    Errc refusal = Errc::ok;         // daemon_not_running: what is left of the plan is for later
    std::optional<Time> again = {};  // then there may be room for what there was none for
  };
  [[nodiscard]] Applied apply(const Plan& plan);
  /// Everything, at once.
  void end_all();

  bool has_source(const Guid& writer) const { return sources_.all().contains(writer); }
  /// Whether it is an inlet.
  bool has(const DdsReader* reader) const { return inlet_of_.contains(reader); }
  /// What an inlet has received, as much as it may take before others have their turn.
  static std::vector<DdsSample> take(DdsReader& inlet);
  /// Whether a message is of a writer that has no source.
  bool has_strangers(std::span<const DdsSample> taken) const;
  /// Publishes what was taken of this inlet; nothing if it has ended meanwhile.
  void publish(const DdsReader* inlet, std::vector<DdsSample> taken);
  /// After a plan.
  void publish_unplaced();
  /// Publishes what waits, and ends what has had its time. Returns when there is something to do again.
  std::optional<Time> tidy(Time now);

  /// Adds inlets to the nodes of this host that they are for.
  void tell(const Plan& plan, const NodesByName& nodes) const;
  /// Adds what there is now. `others` say which nodes the remote writers are of.
  void look(BridgeStatus& now, const RosGraph::Others& others) const;

 private:
  struct OpenInlet {
    std::unique_ptr<DdsReader> reader;
    Inlet plan;
    bool is_over = false;  // not planned any more; ends with the last source that it serves
    std::uint64_t without_source = 0;  // messages
  };

  static ReaderKey reader_of(const Plan& plan, const ClassKey& key);
  void open_sources(const Plan& plan, Applied& applied);
  void open_inlets(const Plan& plan);
  void publish_one(const ReaderKey& inlet, DdsSample sample);
  void publish_former(const ReaderKey& inlet, std::span<const DdsSample> taken);
  /// Ends the inlets that no source needs. Returns when there is something to do again.
  std::optional<Time> settle(Time now);
  template <class Condition>
  void erase_inlets_if(Condition condition);
  RawDecoder decoder_of(std::shared_ptr<const BridgedType> type, const std::string& topic) const;

  DdsParticipant& participant_;
  const MessageTypes& types_;
  const PlanPace& pace_;
  const Log& log_;
  Refusals& refusals_;
  std::map<ReaderKey, OpenInlet> inlets_;
  std::unordered_map<const DdsReader*, const ReaderKey*> inlet_of_;  // keys of inlets_
  Sources sources_;
  // Of writers that no plan knows yet, by inlet.
  std::deque<std::pair<ReaderKey, DdsSample>> unplaced_;
  std::optional<Time> settle_at_;  // then something may have to be ended
};

}  // namespace agnocast::bridge
