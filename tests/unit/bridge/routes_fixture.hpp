// SPDX-License-Identifier: Apache-2.0
//
// Routes: a plan of routes, asked with endpoints of both sides as values.
#pragma once

#include <bridge/plan/routes.hpp>

#include <gmock/gmock.h>

#include <algorithm>
#include <random>
#include <set>
#include <string>
#include <vector>

namespace agnocast::bridge {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

inline constexpr const char* string_type = "std_msgs/msg/String";

class Routes : public testing::Test {
 protected:
  std::uint64_t local(EndpointKind kind, const std::string& topic, const QoS& qos = QoS(10),
                      const std::string& node = "node", const std::string& type = string_type,
                      std::uint64_t domain = 0) {
    EndpointInfo info;
    info.kind = kind;
    info.domain = domain;
    info.topic = topic;
    info.type = type;
    info.node_name = node;
    info.node_namespace = "/ns";
    info.qos = qos;
    info.generation = ++generation_;
    locals_.push_back(info);
    return info.generation;
  }
  std::uint64_t publisher(const std::string& topic, const QoS& qos = QoS(10),
                          const std::string& node = "talker") {
    return local(EndpointKind::publisher, topic, qos, node);
  }
  std::uint64_t subscription(const std::string& topic, const QoS& qos = QoS(10),
                             const std::string& node = "listener") {
    return local(EndpointKind::subscription, topic, qos, node);
  }
  Guid remote(Remote::Kind kind, const std::string& dds_topic, bool reliable = true,
              bool transient_local = false, std::int32_t depth = 10,
              const std::string& dds_type = "std_msgs::msg::dds_::String_") {
    Remote remote;
    remote.kind = kind;
    remote.guid.bytes[0] = static_cast<std::uint8_t>(remotes_.size() + 1);
    remote.guid.bytes[1] = static_cast<std::uint8_t>((remotes_.size() + 1) >> 8);
    remote.topic = dds_topic;
    remote.type = dds_type;
    remote.qos.reliable = reliable;
    remote.qos.transient_local = transient_local;
    remote.qos.depth = depth;
    remotes_[remote.guid] = remote;
    return remote.guid;
  }
  Guid reader(const std::string& dds_topic, bool reliable = true, bool transient_local = false) {
    return remote(Remote::Kind::reader, dds_topic, reliable, transient_local);
  }
  Guid writer(const std::string& dds_topic, bool reliable = true, bool transient_local = false,
              std::int32_t depth = 10) {
    return remote(Remote::Kind::writer, dds_topic, reliable, transient_local, depth);
  }
  Plan plan() {
    return plan_of(
        {0, locals_, &remotes_, rules_,
         [this](const std::string& type) {
           ++asked_;
           return type == string_type ? std::nullopt : std::optional<std::string>("not found");
         },
         otherwise_, [this](const Guid& guid) { return has_remote_publisher_.contains(guid); },
         announce_});
  }

  std::vector<EndpointInfo> locals_;
  DdsParticipant::Remotes remotes_;
  std::vector<Rule> rules_;
  Direction otherwise_ = Direction::both;
  bool announce_ = false;
  std::set<Guid> has_remote_publisher_;
  std::uint64_t generation_ = 0;
  int asked_ = 0;
};

inline const TopicKey chatter{"/chatter", string_type};
inline ReaderKey local_reader(const QosClass& qos_class, std::size_t depth, bool keep_all = false) {
  return {{chatter, qos_class}, depth, keep_all};
}

}  // namespace agnocast::bridge
