// SPDX-License-Identifier: Apache-2.0
//
// Routes: what the bridge has to have at one moment, from what there is on both sides. Pure: values in, a plan
// out. Whoever carries it out compares it with what it has.
//
// Outward, from agnocast to DDS, for a topic that remote readers and local publishers have:
//
//   publisher A ─┐                ┌─▶ outlet A: a DDS writer with A's QoS, in the name of A's node
//                ├─ tap of their ─┤
//   publisher B ─┘  QoS           └─▶ outlet B
//
// Inward, for a topic that remote writers and local subscriptions have:
//
//   remote writer C ─┐                    ┌─▶ source C: a publisher with C's QoS
//                    ├─ inlet of what is ─┤
//   remote writer D ─┘  requested of them └─▶ source D
//
// A class is reliability and durability. A tap (a subscription) requests what its publishers offer and keeps as much as
// they do: one that kept more would have others' publishers retain more. An inlet (a DDS reader) requests what the
// subscriptions that its writers serve request of them together. Both get messages of others too, and
// pass on only what is of their own publishers or writers. So every message goes one way once, history comes where it is
// offered and wanted, and best effort stays best effort. Publishers keep who they are on the other side.
//
// No loops: DDS does not give a participant its own samples, a tap passes on only outlets' publishers, and
// whatever belongs to a bridge's process (is_bridge) is on neither list.
//
// Nothing is made for a topic that is not there on both sides, but for the inlets of what subscriptions request (two
// bridges that both waited for the other one's endpoints would wait for ever), and for the announced writers, by which
// readers in DDS find the topics of this host. If a rule says `always`, a publisher of
// this host has its outlet although nobody reads it in DDS, and a remote writer its source although nobody subscribes
// here.
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

/// "/ns/node"
std::string full_name_of(const EndpointInfo& endpoint);
/// For people.
std::string reason_of(const Verdict& verdict);

struct QosClass {
  bool reliable = true;
  bool transient_local = false;

  auto operator<=>(const QosClass&) const = default;
};

/// What may be bridged with each other: everything else is a topic of its own.
struct TopicKey {
  std::string topic, type;  ///< as ROS has them

  auto operator<=>(const TopicKey&) const = default;
};

struct ClassKey {
  TopicKey key;
  QosClass qos_class;

  auto operator<=>(const ClassKey&) const = default;
};
/// What several share: a tap, or an inlet.
struct ReaderKey {
  ClassKey of;
  std::size_t depth = 1;
  bool keep_all = false;

  auto operator<=>(const ReaderKey&) const = default;
};
struct Outlet {
  ReaderKey tap;  ///< as the publisher has it
  bool keep_all = false;
  std::size_t depth = 1;
  std::string node;  ///< full name
  QosClass offered;  ///< in DDS: its tap's, unless a rule says otherwise
};
/// Another depth makes it another DDS reader.
struct Inlet {
  std::size_t depth = 1;
  bool keep_all = false;
  std::set<std::string> nodes;  ///< full names, of the subscriptions that it serves
  QosClass requested;           ///< in DDS: its class, unless a rule says otherwise
};
struct Source {
  TopicKey key;
  QosClass qos_class;
  std::size_t depth = 1;
  bool keep_all = false;
  QosClass inlet;  ///< the class of the inlet that reads it
};

enum class WhyNot : std::uint8_t {
  rule,          ///< the configuration says so
  no_reader,     ///< nobody in DDS reads it
  no_writer,     ///< nobody in DDS writes it
  no_server,     ///< of a service: nobody in DDS serves it
  other_type,    ///< in DDS it has another type
  unknown_type,  ///< messages of the type cannot be handled here
  no_ros_name,   ///< the type's name is none that ROS has
  qos,           ///< who is there does not match: reliability or durability
  too_many,      ///< more writers in DDS than a topic has sources
};
/// An endpoint kind of a topic or service that this host has, and that does not go to or come from DDS.
struct Unbridged {
  std::string topic, type;
  Direction way = Direction::outward;
  WhyNot why = WhyNot::rule;
  std::string detail;  ///< for people: the rule, the other type, what was searched
  bool is_service = false;

  bool operator==(const Unbridged&) const = default;
};

DdsQos dds_qos_of(const QosClass& qos_class, std::size_t depth, bool keep_all);
QoS qos_of(const QosClass& qos_class, std::size_t depth, bool keep_all);

struct Plan {
  std::map<std::uint64_t, Outlet> outlets;  ///< by generation of the publisher
  /// By the same: publishers that nobody in DDS reads, and whose writers are announced there; `tap` is not made.
  std::map<std::uint64_t, Outlet> announced;
  std::set<ReaderKey> taps;
  std::map<ClassKey, Inlet> inlets;
  std::map<Guid, Source> sources;  ///< by remote writer
  std::vector<Unbridged> unbridged;
};

struct Situation {
  std::uint64_t domain = 0;
  std::span<const EndpointInfo> local;  ///< of any domain and process
  const DdsParticipant::Remotes* remote = nullptr;
  std::span<const Rule> rules;
  /// Why messages of a ROS type cannot be handled here; nothing if they can. Asked once for each type that may be
  /// bridged.
  std::function<std::optional<std::string>(const std::string& type)> problem_of_type;
  Direction otherwise = Direction::both;  ///< of topics that no rule speaks of
  /// Whether a remote writer has its source: of too many those keep theirs.
  std::function<bool(const Guid& writer)> has_source = {};
  bool announce = false;  ///< publishers that nobody reads have a writer in DDS as well
};

/// Other hosts have as many writers as they like: half of the publishers that a topic may have here, so that those of
/// this host find their places.
inline constexpr std::size_t sources_per_topic_max = abi::publisher_count_max / 2;

/// When a topic has too many writers, those that one participant has beyond this give way to others'.
inline constexpr std::size_t sources_of_participant_share = sources_per_topic_max / 2;

/// Looks at everything there is, and costs n log n of it.
Plan plan_of(const Situation& situation);

}  // namespace agnocast::bridge
