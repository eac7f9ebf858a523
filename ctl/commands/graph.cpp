// SPDX-License-Identifier: Apache-2.0
//
// graph: nodes and topics as a picture: for dot (Graphviz), for Mermaid, or as JSON.
//
// An edge from a node to a topic shows the traffic: the rate, from the stamps of the last few
// messages, and the mean size of a message. An edge from a topic to a node is solid if the node
// gets the messages without a copy, else dashed, with the reason.

#include <base/clock.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/snapshot/numbers.hpp>
#include <ctl/snapshot/pairs.hpp>
#include <ctl/snapshot/select.hpp>
#include <ctl/snapshot/system.hpp>

#include <algorithm>
#include <map>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

namespace agnocast::ctl {
namespace {

constexpr std::size_t recent_max = 16;

struct Edge {
  std::size_t node = 0, topic = 0;
  bool publishes = false;
  std::optional<double> rate_hz;  // for a publisher; unknown if only one message is left
  std::uint64_t message_bytes = 0;
  bool is_zero_copy = true;  // for a subscription: from every publisher
  std::string why;
};

struct Graph {
  std::vector<Node> nodes;
  std::vector<const Topic*> topics;
  std::vector<Edge> edges;
};

Edge published_edge(const System& system, const Topic& topic, const Endpoint& publisher,
                    std::uint64_t now_ns) {
  Edge edge;
  edge.publishes = true;
  edge.rate_hz = rate_of(recent_stamps(system, publisher, recent_max), now_ns);
  const auto numbers = counters_of_publisher(system, topic, publisher);
  if (numbers && numbers->published != 0)
    edge.message_bytes = numbers->published_bytes / numbers->published;
  return edge;
}

/// Adds what is not zero-copy, by subscription.
void add_subscribed_edges(const std::vector<Pair>& pairs, std::map<const Endpoint*, Edge>& edges) {
  for (const Pair& pair : pairs) {
    if (is_zero_copy(pair.state)) continue;
    Edge& edge = edges[pair.subscription];
    edge.is_zero_copy = false;
    if (edge.why.empty()) edge.why = pair.why;
  }
}

Graph graph_of(const System& system, const Arguments& arguments) {
  Graph graph;
  graph.nodes = nodes_of(system, arguments);
  std::map<const Topic*, std::size_t> number;
  std::map<const Endpoint*, Edge> subscribed;
  for (const Topic* const topic : topics_of(system, arguments)) {
    if (!arguments.has(options::hidden) && is_hidden(topic->name)) continue;
    number[topic] = graph.topics.size();
    graph.topics.push_back(topic);
    add_subscribed_edges(pairs_of(system, *topic), subscribed);
  }
  const std::uint64_t now_ns = monotonic_ns();
  for (std::size_t n = 0; n < graph.nodes.size(); ++n) {
    const auto add = [&](const Node::Of& of, Edge edge) {
      edge.node = n;
      edge.topic = number[of.topic];
      graph.edges.push_back(std::move(edge));
    };
    for (const Node::Of& of : graph.nodes[n].publishers) {
      if (number.count(of.topic) != 0)
        add(of, published_edge(system, *of.topic, *of.endpoint, now_ns));
    }
    for (const Node::Of& of : graph.nodes[n].subscriptions) {
      if (number.count(of.topic) != 0) add(of, subscribed[of.endpoint]);
    }
  }
  return graph;
}

std::string label_of(const Edge& edge) {
  if (!edge.publishes) return edge.why;
  std::string text;
  if (edge.rate_hz) {
    char rate[32];
    std::snprintf(rate, sizeof rate, "%.1f Hz", *edge.rate_hz);
    text = rate;
  }
  if (edge.message_bytes == 0) return text;
  return text + (text.empty() ? "" : ", ") + bytes_for_people(edge.message_bytes);
}

void print_dot(const Graph& graph, Console& console) {
  console.line("digraph agnocast {\n  rankdir=LR;\n  node [fontname=\"sans-serif\"];");
  for (std::size_t n = 0; n < graph.nodes.size(); ++n)
    console.line("  n" + std::to_string(n) + " [label=" + in_quotes(graph.nodes[n].full_name()) +
                 ", shape=box];");
  for (std::size_t t = 0; t < graph.topics.size(); ++t)
    console.line("  t" + std::to_string(t) + " [label=\"" + escaped(graph.topics[t]->name) + "\\n" +
                 escaped(graph.topics[t]->type) + "\", shape=ellipse];");
  for (const Edge& edge : graph.edges) {
    const std::string node = "n" + std::to_string(edge.node),
                      topic = "t" + std::to_string(edge.topic);
    const auto& [from, to] = edge.publishes ? std::tie(node, topic) : std::tie(topic, node);
    console.line("  " + from + " -> " + to + " [label=\"" + escaped(label_of(edge)) + '"' +
                 (edge.is_zero_copy ? "" : ", style=dashed, color=red") + "];");
  }
  console.line("}");
}

// Quotes would end a Mermaid label; escaped() has turned them into \".
std::string mermaid_text(const std::string& text) {
  std::string all;
  for (const char c : escaped(text)) {
    if (c == '"' || c == '|') {
      all += c == '"' ? "#quot;" : "#124;";
    } else {
      all += c;
    }
  }
  return all;
}

void print_mermaid(const Graph& graph, Console& console) {
  console.line("flowchart LR");
  for (std::size_t n = 0; n < graph.nodes.size(); ++n)
    console.line("  n" + std::to_string(n) + "[\"" + mermaid_text(graph.nodes[n].full_name()) +
                 "\"]");
  for (std::size_t t = 0; t < graph.topics.size(); ++t)
    console.line("  t" + std::to_string(t) + "([\"" + mermaid_text(graph.topics[t]->name) +
                 "<br/>" + mermaid_text(graph.topics[t]->type) + "\"])");
  for (const Edge& edge : graph.edges) {
    const std::string node = "n" + std::to_string(edge.node),
                      topic = "t" + std::to_string(edge.topic);
    const std::string label = mermaid_text(label_of(edge));
    const std::string arrow = std::string(edge.is_zero_copy ? " -->" : " -.->") +
                              (label.empty() ? " " : "|\"" + label + "\"| ");
    const auto& [from, to] = edge.publishes ? std::tie(node, topic) : std::tie(topic, node);
    console.line("  " + from + arrow + to);
  }
}

Object object_of(const Graph& graph) {
  Object object{{"schema", "agnocast.graph/1"}};
  for (const char* const part : {"nodes", "topics", "edges"}) object[part] = Object::array();
  for (const Node& node : graph.nodes)
    object["nodes"].push_back({{"name", node.full_name()}, {"client_index", node.client}});
  for (const Topic* const topic : graph.topics)
    object["topics"].push_back(
        {{"name", topic->name}, {"type", topic->type}, {"domain", topic->facts.domain}});
  for (const Edge& edge : graph.edges) {
    Object item{{"node", edge.node},
                {"topic", edge.topic},
                {"direction", edge.publishes ? "publishes" : "subscribes"}};
    if (edge.publishes) {
      item["rate_hz"] = edge.rate_hz ? Object(*edge.rate_hz) : Object(nullptr);
      item["message_mean_bytes"] = edge.message_bytes;
    } else {
      item["is_zero_copy"] = edge.is_zero_copy;
      item["why"] = edge.why;
    }
    object["edges"].push_back(std::move(item));
  }
  return object;
}

}  // namespace

Outcome<void> draw_graph(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  const Graph graph = graph_of(look->system, arguments);
  if (arguments.json != Json::no) {
    console.object(object_of(graph), arguments.json);
  } else if (arguments.text(options::graph_form) == "mermaid") {
    print_mermaid(graph, console);
  } else {
    print_dot(graph, console);
  }
  return {};
}

}  // namespace agnocast::ctl
