// SPDX-License-Identifier: Apache-2.0
//
// Routes: what the bridge must have at one moment, derived from the endpoints on both sides. Pure:
// values in, a plan out. The caller compares the plan with what exists and carries it out.
//
// Outward, from agnocast to DDS, for a topic with remote readers and local publishers:
//
//   publisher A ─┐                   ┌─▶ DDS writer A, with A's QoS, owned by A's node
//                ├─ local reader of ─┤
//   publisher B ─┘  their QoS        └─▶ DDS writer B
//
// Inward, for a topic with remote writers and local subscriptions:
//
//   remote writer C ─┐                   ┌─▶ remote publisher C: a publisher here, with C's QoS
//                    ├─ DDS reader with ─┤
//   remote writer D ─┘  one request      └─▶ remote publisher D
//
// A class is reliability and durability. A local reader (`local_reader`) requests what its
// publishers offer and keeps as much: a deeper one would make other publishers retain more. A DDS
// reader (`dds_reader`) requests the union of the requests of the subscriptions that its writers
// serve. Both get messages of others too, and pass on only those of their own publishers or
// writers. So every message goes one way once, history goes where it is offered and requested, and
// best effort stays best effort. Each publisher keeps its identity.
//
// No loops: DDS gives a participant none of its own samples, a local reader passes on only
// publishers with a DDS writer, and a bridge's own endpoints (is_bridge) are on neither list.
//
// Nothing is made for a topic that one side lacks, with two exceptions: DDS readers for the
// requests of subscriptions (otherwise two bridges would wait for each other's endpoints for
// ever), and announced writers, by which readers in DDS find the topics of this host. With the
// rule `always`, a publisher of this host has its DDS writer (`dds_writer`) without a reader in
// DDS, and a remote writer its remote publisher (`remote_publisher`) without a subscription here.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/graph.hpp>
#include <agnocast/qos.hpp>
#include <bridge/dds/names.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/plan/rules.hpp>

#include <compare>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::bridge {

inline bool is_bridge(const EndpointInfo& endpoint) noexcept {
  return endpoint.node_name.starts_with(bridge_node);
}

/// Returns "/ns/node".
std::string full_name_of(const EndpointInfo& endpoint);
/// Returns the reason for a verdict, for people.
std::string reason_of(const Verdict& verdict);

// clang-tidy 14 takes the zero behind <=> for a pointer. NOLINTBEGIN(modernize-use-nullptr)
struct QosClass {
  bool reliable = true;
  bool transient_local = false;

  auto operator<=>(const QosClass&) const = default;
};

/// Endpoints with this key may be bridged with each other; any other type is a topic of its own.
struct TopicKey {
  std::string topic, type;  ///< in ROS form

  auto operator<=>(const TopicKey&) const = default;
};

struct ClassKey {
  TopicKey key;
  QosClass qos_class;

  auto operator<=>(const ClassKey&) const = default;
};
/// The key of a shared reader: a local reader or a DDS reader.
struct ReaderKey {
  ClassKey of;
  std::size_t depth = 1;
  bool keep_all = false;

  auto operator<=>(const ReaderKey&) const = default;
};
// NOLINTEND(modernize-use-nullptr)

/// Times of an endpoint's QoS, which the bridge only passes on; infinite: none.
struct QosTimes {
  std::chrono::nanoseconds deadline = DdsQos::infinite, lifespan = DdsQos::infinite;
};

struct DdsWriterPlan {
  ReaderKey local_reader;  ///< with the publisher's QoS
  bool keep_all = false;
  std::size_t depth = 1;
  std::string node;  ///< full name
  QosClass offered;  ///< in DDS: as its local reader, unless a rule overrides it
  QosTimes times;    ///< of the publisher
};
/// Another depth makes it another DDS reader.
struct DdsReaderPlan {
  std::size_t depth = 1;
  bool keep_all = false;
  std::set<std::string> nodes;  ///< full names, of the subscriptions that it serves
  QosClass requested;           ///< in DDS: its class, unless a rule overrides it
};
struct RemotePublisherPlan {
  TopicKey key;
  QosClass qos_class;
  std::size_t depth = 1;
  bool keep_all = false;
  QosClass dds_reader;  ///< the class of the DDS reader that reads it
  QosTimes times;       ///< of the writer
};

enum class WhyNot : std::uint8_t {
  rule,          ///< the configuration excludes it
  no_reader,     ///< it has no reader in DDS
  no_writer,     ///< it has no writer in DDS
  no_server,     ///< a service without a server in DDS
  other_type,    ///< in DDS it has another type
  unknown_type,  ///< the message type is not available here
  no_ros_name,   ///< the type's name is not a ROS name
  qos,           ///< the endpoints do not match: reliability or durability
  too_many,      ///< more writers in DDS than a topic may have remote publishers
};
/// A topic or service of this host that is not bridged in one direction.
struct Unbridged {
  std::string topic, type;
  Direction way = Direction::outward;
  WhyNot why = WhyNot::rule;
  std::string detail;  ///< for people: the rule, the other type, the searched paths
  bool is_service = false;

  bool operator==(const Unbridged&) const = default;
};

DdsQos dds_qos_of(const QosClass& qos_class, std::size_t depth, bool keep_all,
                  const QosTimes& times = {});
QoS qos_of(const QosClass& qos_class, std::size_t depth, bool keep_all, const QosTimes& times = {});

struct Plan {
  std::map<std::uint64_t, DdsWriterPlan> dds_writers;  ///< by generation of the publisher
  /// With the same key: publishers without a reader in DDS whose writers are announced;
  /// `local_reader` is not made.
  std::map<std::uint64_t, DdsWriterPlan> announced;
  std::set<ReaderKey> local_readers;
  std::map<ClassKey, DdsReaderPlan> dds_readers;
  std::map<Guid, RemotePublisherPlan> remote_publishers;  ///< by remote writer
  std::vector<Unbridged> unbridged;
};

struct Situation {
  std::uint64_t domain = 0;
  std::span<const EndpointInfo> local;  ///< of any domain and process
  const DdsParticipant::Remotes* remote = nullptr;
  std::span<const Rule> rules;
  /// Returns why messages of a ROS type are not available here; nothing if they are. Called once
  /// for each type that may be bridged.
  std::function<std::optional<std::string>(const std::string& type)> problem_of_type;
  Direction otherwise = Direction::both;  ///< for topics that no rule matches
  /// Returns whether a remote writer has its remote publisher: if there are too many, it keeps it.
  std::function<bool(const Guid& writer)> has_remote_publisher = {};
  bool announce = false;  ///< give publishers without a reader a writer in DDS as well
};

/// Other hosts may have any number of writers: half of the publishers that a topic may have here
/// if it is not wide, which leaves room for those of this host.
inline constexpr std::size_t remote_publishers_per_topic_max = abi::link_block_count / 2;

/// If a topic has too many writers, one participant's writers beyond this give way to others'.
inline constexpr std::size_t remote_publishers_of_participant_share =
    remote_publishers_per_topic_max / 2;

/// Reads all endpoints, in n log n.
Plan plan_of(const Situation& situation);

}  // namespace agnocast::bridge
