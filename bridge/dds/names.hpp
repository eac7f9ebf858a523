// SPDX-License-Identifier: Apache-2.0
//
// Names as ROS 2 writes them in DDS, in both directions. A text that is no such name gives
// nothing, so that each conversion can be reversed.
//
//   topic /a/b                  rt/a/b
//   service /s                  rq/sRequest and rr/sReply
//   pkg/msg/Name                pkg::msg::dds_::Name_
//   pkg/srv/Name_Request        pkg::srv::dds_::Name_Request_
//   pkg/action/Name_Goal        pkg::action::dds_::Name_Goal_
//
// Actions are services and topics below /NAME/_action/ and need no rule of their own.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace agnocast::bridge {

/// The prefix of the nodes that own a bridge's endpoints: a name that ROS hides.
inline constexpr std::string_view bridge_node = "_agnocast_bridge";

enum class DdsTopicKind : std::uint8_t { topic, request, reply };

struct RosTopic {
  DdsTopicKind kind = DdsTopicKind::topic;
  std::string name;  ///< fully qualified name of the topic or service: "/a/b"

  bool operator==(const RosTopic&) const = default;
};

/// Return nothing unless the name is fully qualified: tokens of letters, digits and underscores
/// that do not begin with a digit, at most 255 bytes. Any thread.
std::optional<std::string> dds_topic_of(const RosTopic& topic);
std::optional<RosTopic> ros_topic_of(std::string_view dds_topic);

/// Return nothing unless the type is "package/msg/Name", or a part of a service or an action as
/// rosidl names it. Any thread.
std::optional<std::string> dds_type_of(std::string_view ros_type);
std::optional<std::string> ros_type_of(std::string_view dds_type);

}  // namespace agnocast::bridge
