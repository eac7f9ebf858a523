// SPDX-License-Identifier: Apache-2.0
//
// OutwardRoutes: carries out the plans of routes.hpp from this host to DDS.
//
//   lanes   (a thread each) messages of local readers ──▶ their DDS writers; large messages of a
//           topic delay only the other topics of its lane
//
// A message is written from shared memory directly into the DDS sample: see dds_writers.hpp.
// Publishers without a reader in DDS are only announced.
//
// Everything except the callbacks of local readers is run()'s thread.
#pragma once

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>
#include <agnocast/graph.hpp>
#include <bridge/common/lane.hpp>
#include <bridge/common/linger.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/message_types.hpp>
#include <bridge/common/refusals.hpp>
#include <bridge/common/slow_deleter.hpp>
#include <bridge/common/status.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/dds/ros_graph.hpp>
#include <bridge/outward/announced.hpp>
#include <bridge/outward/dds_writers.hpp>
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
  /// All must outlive it. `lanes` own the subscriptions.
  OutwardRoutes(DdsParticipant& participant, const Lanes& lanes, const MessageTypes& types,
                const Log& log, SlowDeleter& deleter, Refusals& refusals)
      : participant_(participant),
        lanes_(lanes),
        types_(types),
        refusals_(refusals),
        dds_writers_(log, deleter, [&participant] { participant.interrupt(); }),
        announced_(deleter) {}

  /// Ends DDS writers for which the plan has another QoS, which cannot change while they live.
  void end_changed(const Plan& plan);
  /// `local` are the endpoints of the plan. daemon_not_running: retry the rest of the plan later.
  [[nodiscard]] Errc apply(const Plan& plan, std::span<const EndpointInfo> local);
  /// Ends all DDS writers; local readers end with the next plan, unless it needs them.
  void end_all();
  /// Call for a new agnocastd: generations mean other endpoints from now on.
  void begin_anew();
  /// Ends what is due. Returns when to call it again.
  std::optional<Time> tidy(Time now);

  /// Adds writers to the nodes of this host that own them.
  void tell(const NodesByName& nodes) const;
  /// Adds the current state.
  void look(BridgeStatus& now) const;

 private:
  struct OpenLocalReader {
    std::size_t lane = 0;
    GenericSubscription::SharedPtr subscription;
    bool is_over = false;  // no longer planned; ends when no DDS writer needs it
  };
  /// The local readers of each topic.
  using LocalReadersOfTopic = std::map<TopicKey, std::set<ReaderKey>>;

  void close_others(const Plan& plan, const std::set<std::uint64_t>& present);
  void end_local_readers();
  [[nodiscard]] Errc open_local_readers(const Plan& plan);
  /// `former` are the local readers before the plan. Adds publishers whose writer could not be
  /// made to `without`.
  void open_dds_writers(const Plan& plan, LocalReadersOfTopic former,
                        std::set<std::uint64_t>& without);

  DdsParticipant& participant_;
  const Lanes& lanes_;
  const MessageTypes& types_;
  Refusals& refusals_;
  DdsWriters dds_writers_;
  std::set<std::uint64_t> dds_writer_keys_;
  Announced announced_;
  // Generations of the endpoints of this host in the newest plan.
  std::set<std::uint64_t> planned_for_;
  std::optional<Time> settle_at_;  // when local readers may have to end
  std::map<ReaderKey, OpenLocalReader>
      local_readers_;  // end before the DDS writers that they write to
};

}  // namespace agnocast::bridge
