// SPDX-License-Identifier: Apache-2.0
//
// DiscoveryInfo: exchanges the nodes and their endpoints with other participants, as ROS 2 does
// (ros_discovery_info; ros_graph.hpp), and logs failures. One thread, run()'s.
//
// A node of rclcpp that also uses agnocast is in DDS by itself, so the bridge does not announce it
// a second time: its endpoints here belong to the bridge's own node.
#pragma once

#include <agnocast/graph.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/refusals.hpp>
#include <bridge/dds/ros_graph.hpp>

#include <cstdint>
#include <functional>
#include <set>
#include <span>
#include <string>

namespace agnocast::bridge {

class DiscoveryInfo {
 public:
  /// All must outlive it.
  DiscoveryInfo(std::uint32_t domain, RosGraph& graph, const Log& log, Refusals& refusals)
      : domain_(domain), graph_(graph), log_(log), refusals_(refusals) {}

  const DdsReader* reader() const noexcept { return graph_.reader(); }
  /// Takes the messages of other participants. Returns whether say() may now have other
  /// nodes to say.
  bool hear();
  /// Publishes the nodes of this host in the domain, with the endpoints that `add` gives them.
  void say(std::span<const EndpointInfo> local, const std::function<void(const NodesByName&)>& add);

 private:
  std::set<std::string> announced_by_others() const;

  const std::uint32_t domain_;
  RosGraph& graph_;
  const Log& log_;
  Refusals& refusals_;
  std::set<std::string> local_;         // full names of the nodes at the last say()
  std::uint64_t refused_reported_ = 0;  // count in the last log line
  Seldom reports_refused_;
};

}  // namespace agnocast::bridge
