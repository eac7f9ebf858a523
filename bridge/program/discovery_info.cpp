// SPDX-License-Identifier: Apache-2.0

#include <bridge/program/discovery_info.hpp>

#include <bridge/dds/names.hpp>
#include <bridge/plan/routes.hpp>

#include <map>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::bridge {

void DiscoveryInfo::hear() {
  if (const auto others = graph_.update(); !others)
    refusals_.note("ros_discovery_info", others.error().text());
  const std::uint64_t refused = graph_.refused();
  if (refused <= refused_told_ || !tells_refused_.now()) return;
  refused_told_ = refused;
  log_.write(LogLevel::warning, "malformed ros_discovery_info",
             {{"refused", std::to_string(refused)}});
}

void DiscoveryInfo::say(std::span<const EndpointInfo> local,
                        const std::function<void(const NodesByName&)>& add) {
  std::map<std::pair<std::string, std::string>, RosNode> nodes;
  NodesByName by_name;
  // The node by which other bridges recognize this one.
  nodes[{"/", std::string(bridge_node)}] = {"/", std::string(bridge_node), {}, {}};
  for (const EndpointInfo& endpoint : local) {
    if (endpoint.domain != domain_ || is_bridge(endpoint)) continue;
    RosNode& node = nodes[{endpoint.node_namespace, endpoint.node_name}];
    node.name_space = endpoint.node_namespace;
    node.name = endpoint.node_name;
    by_name[full_name_of(endpoint)] = &node;
  }
  add(by_name);
  std::vector<RosNode> list;
  for (auto& [name, node] : nodes) list.push_back(std::move(node));
  if (const auto said = graph_.set_nodes(std::move(list)); !said)
    refusals_.note("ros_discovery_info", said.error().text());
}

}  // namespace agnocast::bridge
