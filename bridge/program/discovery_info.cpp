// SPDX-License-Identifier: Apache-2.0

#include <bridge/program/discovery_info.hpp>

#include <bridge/dds/names.hpp>
#include <bridge/plan/routes.hpp>

#include <map>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::bridge {

bool DiscoveryInfo::hear() {
  const auto are_others_new = graph_.update();
  if (!are_others_new) refusals_.note("ros_discovery_info", are_others_new.error().text());
  const std::uint64_t refused = graph_.refused();
  if (refused > refused_reported_ && reports_refused_.now()) {
    refused_reported_ = refused;
    log_.write(LogLevel::warning, "malformed ros_discovery_info",
               {{"refused", std::to_string(refused)}});
  }
  return !are_others_new || *are_others_new;
}

std::set<std::string> DiscoveryInfo::announced_by_others() const {
  std::set<std::string> found;
  for (const auto& [participant, entities] : graph_.others()) {
    if (is_of_bridge(entities)) continue;
    for (const RosNode& node : entities.nodes) {
      if (std::string name = full_name_of(node); local_.contains(name))
        found.insert(std::move(name));
    }
  }
  return found;
}

void DiscoveryInfo::say(std::span<const EndpointInfo> local,
                        const std::function<void(const NodesByName&)>& add) {
  local_.clear();
  for (const EndpointInfo& endpoint : local) {
    if (endpoint.domain == domain_ && !is_bridge(endpoint)) local_.insert(full_name_of(endpoint));
  }
  const std::set<std::string> theirs = announced_by_others();
  std::map<std::pair<std::string, std::string>, RosNode> nodes;
  NodesByName by_name;
  // The node by which other bridges recognize this one.
  RosNode& own = nodes[{"/", std::string(bridge_node)}];
  own = {"/", std::string(bridge_node), {}, {}};
  for (const EndpointInfo& endpoint : local) {
    if (endpoint.domain != domain_ || is_bridge(endpoint)) continue;
    const std::string name = full_name_of(endpoint);
    if (theirs.contains(name)) {
      by_name[name] = &own;
      continue;
    }
    RosNode& node = nodes[{endpoint.node_namespace, endpoint.node_name}];
    node.name_space = endpoint.node_namespace;
    node.name = endpoint.node_name;
    by_name[name] = &node;
  }
  add(by_name);
  std::vector<RosNode> list;
  for (auto& [name, node] : nodes) list.push_back(std::move(node));
  if (const auto set = graph_.set_nodes(std::move(list)); !set)
    refusals_.note("ros_discovery_info", set.error().text());
}

}  // namespace agnocast::bridge
