// SPDX-License-Identifier: Apache-2.0

#include <ctl/snapshot/select.hpp>

#include <agnocast/service_name.hpp>
#include <base/text/names.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>

#include <algorithm>
#include <charconv>
#include <map>
#include <set>
#include <string_view>
#include <tuple>

namespace agnocast::ctl {

std::uint64_t active_count(const std::vector<Endpoint>& endpoints) {
  return static_cast<std::uint64_t>(std::count_if(
      endpoints.begin(), endpoints.end(),
      [](const Endpoint& endpoint) { return endpoint.state() == abi::BoardState::active; }));
}

std::string fully_qualified(const std::string& name) {
  return name.starts_with('/') ? name : '/' + name;
}

Outcome<JournalFilter> filter_of(const Arguments& arguments) {
  JournalFilter filter{arguments.text(options::of_topic), arguments.text(options::of_process)};
  if (filter.topic.empty()) return filter;
  filter.topic = fully_qualified(filter.topic);
  if (const auto wrong = check_topic_name(filter.topic))
    return problem(Status::wrong_usage, in_quotes(filter.topic), wrong->text(),
                   full_name(*arguments.command) + " --help");
  return filter;
}

bool is_hidden(const std::string& name) { return name.find("/_") != std::string::npos; }

std::vector<const Topic*> topics_of(const System& system, const Arguments& arguments) {
  std::vector<const Topic*> topics;
  for (const auto& [index, topic] : system.topics) {
    if (!arguments.all_domains && topic.facts.domain != arguments.domain) continue;
    topics.push_back(&topic);
  }
  std::sort(topics.begin(), topics.end(), [](const Topic* a, const Topic* b) {
    return a->name != b->name ? a->name < b->name : a->facts.domain < b->facts.domain;
  });
  return topics;
}

Outcome<const Topic*> find_topic(const System& system, const Arguments& arguments,
                                 const std::string& wanted) {
  const std::string name = fully_qualified(wanted);
  const std::string command = full_name(*arguments.command) + ' ';
  std::vector<std::string_view> names;
  for (const Topic* topic : topics_of(system, arguments)) {
    if (topic->name == name) return topic;
    names.push_back(topic->name);
  }
  std::string why = "there is no such topic in domain " + std::to_string(arguments.domain);
  std::string hint = "agnocast-ctl topic list";
  if (const std::string_view meant = nearest(name, names); !meant.empty()) {
    why += "; did you mean " + escaped(meant) + "?";
    hint = command + escaped(meant);
  }
  for (const auto& [index, other] : system.topics) {
    if (other.name == name)
      hint = command + escaped(name) + " --domain " + std::to_string(other.facts.domain);
  }
  return problem(Status::no_such_thing, escaped(name), why, hint);
}

std::optional<Service> service_of(const Topic& topic) {
  constexpr std::string_view half = "_Request";  // of "pkg/srv/Name"
  TopicRole role = role_of_topic(topic.name);
  if (role.kind != TopicRole::Kind::request) return std::nullopt;
  std::string type = topic.type;
  if (type.ends_with(half)) type.resize(type.size() - half.size());
  return Service{std::move(role.service), std::move(type), &topic};
}

std::vector<Service> services_of(const System& system, const Arguments& arguments) {
  std::vector<Service> services;
  for (const Topic* const topic : topics_of(system, arguments)) {
    auto service = service_of(*topic);
    if (service && active_count(topic->publishers) + active_count(topic->subscriptions) != 0)
      services.push_back(std::move(*service));
  }
  return services;
}

std::string client_of(const wire::DumpProcess& process) {
  return std::to_string(process.client) + '.' + std::to_string(process.generation);
}

std::vector<const Process*> processes_of(const System& system, const Arguments& arguments) {
  std::set<const Process*> with_topic;
  for (const Topic* const topic : topics_of(system, arguments)) {
    for (const auto* endpoints : {&topic->publishers, &topic->subscriptions}) {
      for (const Endpoint& endpoint : *endpoints) with_topic.insert(system.process_of(endpoint));
    }
  }
  std::vector<const Process*> processes;
  for (const auto& [index, process] : system.processes) {
    if (arguments.all_domains || process.facts.domain == arguments.domain ||
        with_topic.contains(&process))
      processes.push_back(&process);
  }
  return processes;
}

Outcome<std::vector<const Process*>> find_processes(const System& system, const std::string& name) {
  std::uint64_t pid = 0;
  const char* const end = name.data() + name.size();
  const auto parsed = std::from_chars(name.data(), end, pid);
  const bool is_pid = parsed.ec == std::errc() && parsed.ptr == end;
  std::vector<const Process*> found;
  for (const auto& [index, process] : system.processes) {
    // The daemon sees such a process without a pid: 0 does not name it.
    if (is_pid ? pid != 0 && process.facts.pid == pid
               : client_of(process.facts) == name || process.name == name)
      found.push_back(&process);
  }
  if (!found.empty()) return found;
  return problem(Status::no_such_thing, escaped(name), "there is no such process",
                 "agnocast-ctl process list --all-domains");
}

namespace {

std::string joined(const std::string& name_space, const std::string& name) {
  return (name_space == "/" ? "" : name_space) + '/' + name;
}

}  // namespace

std::string node_name_of(const Endpoint& endpoint) {
  return joined(endpoint.node_namespace, endpoint.node_name);
}

std::string Node::full_name() const { return joined(name_space, name); }

std::vector<Node> nodes_of(const System& system, const Arguments& arguments) {
  // By name, domain and process.
  std::map<std::tuple<std::string, std::string, std::uint64_t, std::uint64_t, std::uint64_t>, Node>
      nodes;
  for (const Topic* const topic : topics_of(system, arguments)) {
    for (const auto* endpoints : {&topic->publishers, &topic->subscriptions}) {
      for (const Endpoint& endpoint : *endpoints) {
        if (endpoint.state() != abi::BoardState::active) continue;
        const wire::DumpEndpoint& facts = endpoint.facts;
        Node& node = nodes[{endpoint.node_namespace, endpoint.node_name, topic->facts.domain,
                            facts.client, facts.client_generation}];
        node.name = endpoint.node_name;
        node.name_space = endpoint.node_namespace;
        node.domain = topic->facts.domain;
        node.client = facts.client;
        node.client_generation = facts.client_generation;
        (endpoint.is_publisher() ? node.publishers : node.subscriptions)
            .push_back({topic, &endpoint});
      }
    }
  }
  std::vector<Node> list;
  list.reserve(nodes.size());
  for (auto& [key, node] : nodes) list.push_back(std::move(node));
  std::stable_sort(list.begin(), list.end(),
                   [](const Node& a, const Node& b) { return a.full_name() < b.full_name(); });
  return list;
}

std::string process_words(const System& system, const Endpoint& endpoint) {
  const Process* const process = system.process_of(endpoint);
  if (process == nullptr) return "a process that is gone";
  return escaped(process->name) + " (pid " + std::to_string(process->facts.pid) + ", uid " +
         std::to_string(process->facts.uid) + ")";
}

}  // namespace agnocast::ctl
