// SPDX-License-Identifier: Apache-2.0
//
// InwardRoutes: carries out the plans of routes.hpp from DDS to this host.
//
//   Cyclone's threads   fragments ──▶ messages in the shared heap (decoders of the DDS readers)
//   run()               takes it from the DDS readers ──▶ publishes it with remote publishers
//
// A message is read from the fragments directly into shared memory: its publisher is known only
// when it is taken. A message whose writer has no remote publisher yet waits for the pending plan,
// within bounds.
//
// Everything except decoders is run()'s thread.
#pragma once

#include <agnocast/agnocast.hpp>
#include <bridge/common/linger.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/message_types.hpp>
#include <bridge/common/refusals.hpp>
#include <bridge/common/slow_deleter.hpp>
#include <bridge/common/status.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/dds/ros_graph.hpp>
#include <bridge/inward/remote_publishers.hpp>
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
  /// All must outlive it. `node` owns the publishers; `pace` says whether a plan is pending, which
  /// may know writers without a remote publisher.
  InwardRoutes(DdsParticipant& participant, Node& node, const MessageTypes& types,
               const PlanPace& pace, const Log& log, SlowDeleter& deleter, Refusals& refusals)
      : participant_(participant),
        types_(types),
        pace_(pace),
        log_(log),
        refusals_(refusals),
        remote_publishers_(node, types, participant.limits(), deleter, log) {}

  /// Ends DDS readers for which the plan has another QoS, which cannot change while they live.
  void end_changed(const Plan& plan);
  struct Applied {
    Errc refusal = Errc::ok;         // daemon_not_running: retry the rest of the plan later
    std::optional<Time> again = {};  // when to retry what did not fit
  };
  [[nodiscard]] Applied apply(const Plan& plan);
  /// Ends everything at once.
  void end_all();

  bool has_remote_publisher(const Guid& writer) const {
    return remote_publishers_.all().contains(writer);
  }
  /// Returns whether it is one of these DDS readers.
  bool has(const DdsReader* reader) const { return dds_reader_of_.contains(reader); }
  /// Takes what a DDS reader has received, bounded so that others get their turn.
  static std::vector<DdsSample> take(DdsReader& dds_reader);
  /// Returns whether a sample's writer has no remote publisher.
  bool has_unknown_writers(std::span<const DdsSample> taken) const;
  /// Publishes the samples taken from one of these DDS readers.
  void publish(const DdsReader& dds_reader, std::vector<DdsSample> taken);
  /// Call after a plan.
  void publish_unplaced();
  /// Publishes waiting messages and ends what is due. Returns when to call it again.
  std::optional<Time> tidy(Time now);

  /// Adds DDS readers to the nodes of this host that they serve.
  void tell(const Plan& plan, const NodesByName& nodes) const;
  /// Adds the current state. `others` name the nodes of the remote writers.
  void look(BridgeStatus& now, const RosGraph::Others& others) const;

 private:
  struct OpenDdsReader {
    std::unique_ptr<DdsReader> reader;
    DdsReaderPlan plan;
    bool is_over = false;  // no longer planned; ends with its last remote publisher
    std::uint64_t without_remote_publisher = 0;  // messages
  };

  static ReaderKey reader_of(const Plan& plan, const ClassKey& key);
  /// Returns the state of a DDS reader that is left for one with this request.
  ReaderHandover::Left left_of(const ReaderKey& left, const QosClass& requested) const;
  void open_remote_publishers(const Plan& plan, Applied& applied);
  /// By planned DDS reader: remote publishers that are to go over to it.
  std::map<ReaderKey, std::vector<OpenRemotePublisher*>> leaving(const Plan& plan);
  void open_dds_readers(const Plan& plan);
  /// Creates it unless it exists; then these remote publishers go over to it.
  void open_dds_reader(const ReaderKey& key, const DdsReaderPlan& plan,
                       std::span<OpenRemotePublisher* const> remote_publishers);
  bool create_dds_reader(const ReaderKey& key, const DdsReaderPlan& plan);
  void publish_one(const ReaderKey& dds_reader, DdsSample sample);
  void publish_former(const ReaderKey& dds_reader, std::span<const DdsSample> taken);
  /// Publishes what these DDS readers have received, after what those have that their writers
  /// left: it came before.
  void publish_all_of(const std::set<ReaderKey>& dds_readers);
  /// The same of one that is not `done` yet.
  void publish_all_of(const ReaderKey& dds_reader, std::set<ReaderKey>& done);
  /// Publishes what DDS readers have received, before it ends what is due of handovers, and before
  /// publishers of gone writers end.
  void publish_last(Time now);
  /// Ends DDS readers that no remote publisher needs. Returns when to call it again.
  std::optional<Time> settle(Time now);
  template <class Condition>
  void erase_dds_readers_if(Condition condition);
  RawDecoder decoder_of(std::shared_ptr<const BridgedType> type, const std::string& topic) const;

  DdsParticipant& participant_;
  const MessageTypes& types_;
  const PlanPace& pace_;
  const Log& log_;
  Refusals& refusals_;
  std::map<ReaderKey, OpenDdsReader> dds_readers_;
  std::unordered_map<const DdsReader*, const ReaderKey*> dds_reader_of_;  // keys of dds_readers_
  RemotePublishers remote_publishers_;
  // Samples of writers that no plan knows yet, by DDS reader.
  std::deque<std::pair<ReaderKey, DdsSample>> unplaced_;
  std::optional<Time> settle_at_;  // when something may have to end
};

}  // namespace agnocast::bridge
