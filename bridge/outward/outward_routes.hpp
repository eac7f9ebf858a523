// SPDX-License-Identifier: Apache-2.0
//
// OutwardRoutes: carries out what routes.hpp plans from this host to DDS.
//
//   lanes   (nodes' threads, the library's) taps' messages ──▶ writers of their outlets; a topic's large messages hold
//           up the other topics of its lane only
//
// A message is written from shared memory straight into the DDS sample: see outlets.hpp. Publishers that nobody in DDS
// reads are announced only.
//
// Everything but the taps' callbacks is run()'s thread.
#pragma once

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>
#include <agnocast/graph.hpp>
#include <bridge/common/linger.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/message_types.hpp>
#include <bridge/common/reaper.hpp>
#include <bridge/common/refusals.hpp>
#include <bridge/common/status.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/dds/ros_graph.hpp>
#include <bridge/outward/announced.hpp>
#include <bridge/outward/outlets.hpp>
#include <bridge/plan/routes.hpp>

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <vector>

namespace agnocast::bridge {

class OutwardRoutes {
 public:
  using Lanes = std::vector<std::unique_ptr<Node>>;
  /// All must outlive it. `lanes` have the subscriptions.
  OutwardRoutes(DdsParticipant& participant, const Lanes& lanes, const MessageTypes& types,
                const Log& log, Reaper& reaper, Refusals& refusals)
      : participant_(participant),
        lanes_(lanes),
        types_(types),
        refusals_(refusals),
        outlets_(log, reaper, [&participant] { participant.interrupt(); }),
        announced_(reaper) {}

  /// Ends outlets that the plan has with another QoS, which cannot change while they live.
  void end_changed(const Plan& plan);
  /// `local` are the endpoints that the plan was made for. daemon_not_running: what is left of the plan is for later.
  [[nodiscard]] Errc apply(const Plan& plan, std::span<const EndpointInfo> local);
  /// Ends all outlets; taps end with the next plan, if it has none for them.
  void end_all();
  /// Another agnocastd is there: generations mean others from now on.
  void begin_anew();
  /// Ends what has had its time. Returns when there is something to do again.
  std::optional<Time> tidy(Time now);

  /// Adds writers to the nodes of this host that they are for.
  void tell(const NodesByName& nodes) const;
  /// Adds what there is now.
  void look(BridgeStatus& now) const;

 private:
  struct OpenTap {
    std::size_t lane = 0;
    GenericSubscription::SharedPtr subscription;
    bool is_over = false;  // not planned any more; ends when no outlet needs it
  };
  /// The taps that each topic has.
  using TapsOfTopic = std::map<TopicKey, std::set<ReaderKey>>;

  void close_others(const Plan& plan, const std::set<std::uint64_t>& present);
  void end_taps();
  [[nodiscard]] Errc open_taps(const Plan& plan);
  /// `former` are the taps from before the plan. Adds to `without` the publishers whose writer could not be made.
  void open_outlets(const Plan& plan, TapsOfTopic former, std::set<std::uint64_t>& without);

  DdsParticipant& participant_;
  const Lanes& lanes_;
  const MessageTypes& types_;
  Refusals& refusals_;
  Outlets outlets_;
  std::set<std::uint64_t> outlet_keys_;
  Announced announced_;
  // Generations of the endpoints of this host that the newest plan was for.
  std::set<std::uint64_t> planned_for_;
  std::optional<Time> settle_at_;      // then taps may have to be ended
  std::map<ReaderKey, OpenTap> taps_;  // end before the outlets that they write to
};

}  // namespace agnocast::bridge
