// SPDX-License-Identifier: Apache-2.0
//
// service list, info, find, type: in the form of ros2 service. A service is known by the topic of
// its requests: servers subscribe to it, clients publish on it.

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

Outcome<Service> find_service(const System& system, const Arguments& arguments) {
  const std::string name = fully_qualified(arguments.subject(0));
  std::vector<Service> services = services_of(system, arguments);
  std::vector<std::string_view> names;
  for (Service& service : services) {
    if (service.name == name) return std::move(service);
    names.push_back(service.name);
  }
  std::string why = "there is no such service in domain " + std::to_string(arguments.domain);
  std::string hint = "agnocast-ctl service list";
  if (const std::string_view meant = nearest(name, names); !meant.empty()) {
    why += "; did you mean " + escaped(meant) + "?";
    hint = full_name(*arguments.command) + ' ' + escaped(meant);
  }
  return problem(Status::no_such_thing, escaped(name), why, hint);
}

Object summary_of(const Service& service) {
  return {{"name", service.name},
          {"type", service.type},
          {"domain", service.requests->facts.domain},
          {"server_count", active_count(service.requests->subscriptions)},
          {"client_count", active_count(service.requests->publishers)}};
}

Object endpoints_object(const System& system, const std::vector<Endpoint>& endpoints) {
  Object list = Object::array();
  for (const Endpoint& endpoint : endpoints) {
    if (endpoint.state() != abi::BoardState::active) continue;
    const Process* const process = system.process_of(endpoint);
    list.push_back({{"node_name", endpoint.node_name},
                    {"node_namespace", endpoint.node_namespace},
                    {"generation", endpoint.facts.generation},
                    {"pid", process == nullptr ? Object(nullptr) : Object(process->facts.pid)}});
  }
  return list;
}

void print_side(const System& system, const char* heading, const std::vector<Endpoint>& endpoints,
                bool verbose, Console& console) {
  console.line(heading + (": " + std::to_string(active_count(endpoints))));
  if (!verbose) return;
  for (const Endpoint& endpoint : endpoints) {
    if (endpoint.state() == abi::BoardState::active)
      console.line("  " + escaped(node_name_of(endpoint)) + ", " + process_words(system, endpoint));
  }
}

}  // namespace

Outcome<void> list_services(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  auto services = services_of(look->system, arguments);
  if (!arguments.has(options::hidden_services))
    std::erase_if(services, [](const Service& service) { return is_hidden(service.name); });
  if (arguments.json != Json::no) {
    Object list = Object::array();
    for (const Service& service : services) list.push_back(summary_of(service));
    console.object({{"schema", "agnocast.service-list/1"},
                    {"service_count", services.size()},
                    {"services", list}},
                   arguments.json);
  } else if (arguments.has(options::count_services)) {
    console.line(std::to_string(services.size()));
  } else {
    for (const Service& service : services) {
      std::string line = escaped(service.name);
      if (arguments.has(options::show_types)) line += " [" + escaped(service.type) + "]";
      if (arguments.all_domains)
        line += " (domain " + std::to_string(service.requests->facts.domain) + ")";
      console.line(line);
    }
  }
  return {};
}

Outcome<void> show_service(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  const auto service = find_service(look->system, arguments);
  if (!service) return tl::unexpected(service.error());
  const Topic& requests = *service->requests;
  if (arguments.json != Json::no) {
    Object object{{"schema", "agnocast.service-info/1"}};
    object.update(summary_of(*service));
    object["servers"] = endpoints_object(look->system, requests.subscriptions);
    object["clients"] = endpoints_object(look->system, requests.publishers);
    console.object(object, arguments.json);
    return {};
  }
  const bool verbose = arguments.has(options::verbose);
  console.line("Type: " + escaped(service->type));
  print_side(look->system, "Clients count", requests.publishers, verbose, console);
  print_side(look->system, "Services count", requests.subscriptions, verbose, console);
  return {};
}

Outcome<void> find_services(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  auto services = services_of(look->system, arguments);
  std::erase_if(services, [&](const Service& service) {
    return service.type != arguments.subject(0) ||
           (!arguments.has(options::hidden_services) && is_hidden(service.name));
  });
  if (arguments.json != Json::no) {
    Object names = Object::array();
    for (const Service& service : services) names.push_back(service.name);
    console.object({{"schema", "agnocast.service-find/1"},
                    {"type", arguments.subject(0)},
                    {"service_count", services.size()},
                    {"services", names}},
                   arguments.json);
  } else if (arguments.has(options::count_services)) {
    console.line(std::to_string(services.size()));
  } else {
    for (const Service& service : services) console.line(escaped(service.name));
  }
  return {};
}

Outcome<void> show_service_type(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  const auto service = find_service(look->system, arguments);
  if (!service) return tl::unexpected(service.error());
  if (arguments.json == Json::no) {
    console.line(escaped(service->type));
  } else {
    console.object(
        {{"schema", "agnocast.service-type/1"}, {"name", service->name}, {"type", service->type}},
        arguments.json);
  }
  return {};
}

}  // namespace agnocast::ctl
