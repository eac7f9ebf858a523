// SPDX-License-Identifier: Apache-2.0
//
// node list, node info: in the form of ros2 node. A node is known by its endpoints; without any it
// is not listed.

#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/snapshot/select.hpp>
#include <ctl/snapshot/system.hpp>

#include <algorithm>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::ctl {
namespace {

Object endpoints_object(const std::vector<Node::Of>& endpoints) {
  Object list = Object::array();
  for (const auto& [topic, endpoint] : endpoints)
    list.push_back({{"topic", topic->name},
                    {"type", topic->type},
                    {"generation", endpoint->facts.generation}});
  return list;
}

Object services_object(const std::vector<Node::Of>& endpoints) {
  Object list = Object::array();
  for (const auto& [topic, endpoint] : endpoints) {
    if (const auto service = service_of(*topic))
      list.push_back({{"service", service->name},
                      {"type", service->type},
                      {"generation", endpoint->facts.generation}});
  }
  return list;
}

Object object_of(const System& system, const Node& node) {
  const auto found = system.processes.find(node.client);
  const bool known =
      found != system.processes.end() && found->second.facts.generation == node.client_generation;
  return {{"name", node.full_name()},
          {"node_name", node.name},
          {"node_namespace", node.name_space},
          {"pid", known ? Object(found->second.facts.pid) : Object(nullptr)},
          {"domain", node.domain},
          {"publishers", endpoints_object(node.publishers)},
          {"subscribers", endpoints_object(node.subscriptions)},
          {"service_servers", services_object(node.subscriptions)},
          {"service_clients", services_object(node.publishers)}};
}

void print_side(const char* heading, const std::vector<Node::Of>& endpoints, bool hidden,
                Console& console) {
  console.line(heading);
  const Topic* last = nullptr;
  for (const auto& [topic, endpoint] : endpoints) {
    if (topic == last || (!hidden && is_hidden(topic->name))) continue;
    console.line("    " + escaped(topic->name) + ": " + escaped(topic->type));
    last = topic;
  }
}

void print_services(const char* heading, const std::vector<Node::Of>& endpoints, bool hidden,
                    Console& console) {
  console.line(heading);
  const Topic* last = nullptr;
  for (const auto& [topic, endpoint] : endpoints) {
    const auto service = service_of(*topic);
    if (!service || topic == last || (!hidden && is_hidden(service->name))) continue;
    console.line("    " + escaped(service->name) + ": " + escaped(service->type));
    last = topic;
  }
}

}  // namespace

Outcome<void> list_nodes(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  auto nodes = nodes_of(look->system, arguments);
  if (!arguments.has(options::hidden_nodes))
    std::erase_if(nodes, [](const Node& node) { return is_hidden(node.full_name()); });
  if (arguments.json != Json::no) {
    Object list = Object::array();
    for (const Node& node : nodes) list.push_back(object_of(look->system, node));
    console.object(
        {{"schema", "agnocast.node-list/1"}, {"node_count", nodes.size()}, {"nodes", list}},
        arguments.json);
  } else if (arguments.has(options::count_nodes)) {
    console.line(std::to_string(nodes.size()));
  } else {
    for (const Node& node : nodes) console.line(escaped(node.full_name()));
  }
  return {};
}

Outcome<void> show_node(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  const std::string name = fully_qualified(arguments.subject(0));
  const auto all = nodes_of(look->system, arguments);
  std::vector<const Node*> nodes;
  std::vector<std::string> names;
  for (const Node& node : all) {
    names.push_back(node.full_name());
    if (node.full_name() == name) nodes.push_back(&node);
  }
  if (nodes.empty()) {
    const std::vector<std::string_view> views(names.begin(), names.end());
    const std::string_view meant = nearest(name, views);
    return problem(
        Status::no_such_thing, escaped(name),
        "there is no such node in domain " + std::to_string(arguments.domain) +
            (meant.empty() ? "" : "; did you mean " + escaped(meant) + "?"),
        meant.empty() ? "agnocast-ctl node list" : "agnocast-ctl node info " + escaped(meant));
  }
  if (arguments.json != Json::no) {
    Object list = Object::array();
    for (const Node* const node : nodes) list.push_back(object_of(look->system, *node));
    console.object(
        {{"schema", "agnocast.node-info/1"}, {"node_count", nodes.size()}, {"nodes", list}},
        arguments.json);
    return {};
  }
  if (nodes.size() > 1)
    console.line("There are " + std::to_string(nodes.size()) +
                 " nodes in the graph with the exact name \"" + escaped(name) + "\".");
  const bool hidden = arguments.has(options::hidden);
  for (const Node* const node : nodes) {
    console.line(escaped(node->full_name()));
    print_side("  Subscribers:", node->subscriptions, hidden, console);
    print_side("  Publishers:", node->publishers, hidden, console);
    print_services("  Service Servers:", node->subscriptions, hidden, console);
    print_services("  Service Clients:", node->publishers, hidden, console);
  }
  return {};
}

}  // namespace agnocast::ctl
