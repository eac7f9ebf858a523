// SPDX-License-Identifier: Apache-2.0

#include <agnocast/node/agnocast_node.hpp>

#include <agnocast/graph.hpp>

#include <chrono>
#include <cstddef>
#include <string>

namespace agnocast {
namespace {

std::size_t count(const rclcpp::Node& node, const std::string& topic, EndpointKind kind) {
  auto& writable = const_cast<rclcpp::Node&>(node);  // its getters are not const
  const std::string name = writable.get_node_topics_interface()->resolve_topic_name(topic);
  const std::size_t domain = writable.get_node_base_interface()->get_context()->get_domain_id();
  Graph graph;  // a new connection gets the present state
  const auto state = graph.wait(std::chrono::seconds(5));
  if (!state) detail::throw_error(state.error());
  std::size_t found = 0;
  if (!state->has_value()) return found;
  for (const EndpointInfo& endpoint : (*state)->endpoints)
    found += endpoint.topic == name && endpoint.kind == kind && endpoint.domain == domain;
  return found;
}

}  // namespace

std::size_t Node::count_publishers(const std::string& topic_name) const {
  return count(*this, topic_name, EndpointKind::publisher);
}
std::size_t Node::count_subscribers(const std::string& topic_name) const {
  return count(*this, topic_name, EndpointKind::subscription);
}

void init(int argc, char const* const* argv) {
  if (!rclcpp::contexts::get_global_default_context()->is_valid()) rclcpp::init(argc, argv);
}
bool ok() { return rclcpp::ok(); }
void shutdown() { (void)rclcpp::shutdown(); }

}  // namespace agnocast
