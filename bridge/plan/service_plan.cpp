// SPDX-License-Identifier: Apache-2.0

#include <bridge/plan/service_plan.hpp>

#include <agnocast/service_name.hpp>
#include <bridge/dds/names.hpp>

#include <algorithm>
#include <iterator>
#include <optional>
#include <string_view>
#include <utility>

namespace agnocast::bridge {
namespace {

/// Returns the service type; nothing unless `type` is that part of one.
std::optional<std::string> service_of(const std::string& type, std::string_view part) {
  if (!type.ends_with(part)) return std::nullopt;
  return type.substr(0, type.size() - part.size());
}

/// Both endpoints of a server or a client in DDS belong to one participant.
struct Ends {
  std::set<Guid> requests, replies;  // participants

  std::set<Guid> participants() const {
    std::set<Guid> both;
    std::set_intersection(requests.begin(), requests.end(), replies.begin(), replies.end(),
                          std::inserter(both, both.end()));
    return both;
  }
};
struct Service {
  std::map<std::string, ServiceRoute> servers, clients;  // of this host, by type
  std::map<std::string, Ends> remote_servers;
};

class ServicePlanner {
 public:
  explicit ServicePlanner(const Situation& situation) : situation_(situation) {}

  ServicePlan plan() {
    gather_local();
    gather_remote();
    for (const auto& [name, service] : services_) {
      for (const auto& [type, servers] : service.servers) {
        if (is_open({name, type}, Direction::outward)) plan_.served[{name, type}] = servers;
      }
      for (const auto& [type, clients] : service.clients) {
        if (service.servers.contains(type) || !is_open({name, type}, Direction::inward)) continue;
        if (!is_somebody_there({name, type}, service)) continue;
        ServiceRoute& route = plan_.asked[{name, type}] = clients;
        route.servers = service.remote_servers.at(type).participants();
      }
    }
    return std::move(plan_);
  }

 private:
  void gather_local() {
    for (const EndpointInfo& endpoint : situation_.local) {
      if (endpoint.domain != situation_.domain || is_bridge(endpoint)) continue;
      const TopicRole role = role_of_topic(endpoint.topic);
      if (role.kind != TopicRole::Kind::request) continue;
      const auto type = service_of(endpoint.type, "_Request");
      Service& service = services_[role.service];
      auto& side = endpoint.kind == EndpointKind::publisher ? service.clients : service.servers;
      side[type.value_or(endpoint.type)].nodes.insert(full_name_of(endpoint));
    }
  }
  void gather_remote() {
    for (const auto& [guid, remote] : *situation_.remote) {
      if (remote.kind == Remote::Kind::participant) continue;
      const auto topic = ros_topic_of(remote.topic);
      const auto part = ros_type_of(remote.type);
      if (!topic || topic->kind == DdsTopicKind::topic || !part) continue;
      const auto service = services_.find(topic->name);  // only services of this host
      if (service == services_.end()) continue;
      const bool is_request = topic->kind == DdsTopicKind::request;
      const auto type = service_of(*part, is_request ? "_Request" : "_Response");
      if (!type) continue;
      // A server reads requests and writes replies.
      const bool is_server = (remote.kind == Remote::Kind::reader) == is_request;
      if (!is_server) continue;
      Ends& ends = service->second.remote_servers[*type];
      (is_request ? ends.requests : ends.replies).insert(remote.participant);
    }
  }

  void not_bridged(const ServiceKey& key, Direction way, WhyNot why, std::string detail) {
    plan_.unbridged.push_back({key.service, key.type, way, why, std::move(detail), true});
  }
  /// Returns whether rules and type allow the route; records the reason if not.
  bool is_open(const ServiceKey& key, Direction way) {
    const Verdict verdict =
        verdict_of(situation_.rules, key.service, key.type, situation_.otherwise);
    if (!goes(verdict.direction, way)) {
      not_bridged(key, way, WhyNot::rule, reason_of(verdict));
    } else if (!dds_type_of(key.type + "_Request") ||
               !dds_topic_of({DdsTopicKind::request, key.service})) {
      not_bridged(key, way, WhyNot::no_ros_name, "not the name of a ROS service type: " + key.type);
    } else if (const auto problem = problem_of(key.type)) {
      not_bridged(key, way, WhyNot::unknown_type, *problem);
    } else {
      return true;
    }
    return false;
  }
  bool is_somebody_there(const ServiceKey& key, const Service& service) {
    const auto& there = service.remote_servers;
    const auto ends = there.find(key.type);
    if (ends != there.end() && !ends->second.participants().empty()) return true;
    if (there.empty() || ends != there.end()) {
      not_bridged(key, Direction::inward, WhyNot::no_server, {});
    } else {
      not_bridged(key, Direction::inward, WhyNot::other_type,
                  "in DDS it is " + there.begin()->first);
    }
    return false;
  }
  std::optional<std::string> problem_of(const std::string& type) const {
    auto problem = situation_.problem_of_type(type + "_Request");
    return problem ? problem : situation_.problem_of_type(type + "_Response");
  }

  const Situation& situation_;
  std::map<std::string, Service> services_;
  ServicePlan plan_;
};

}  // namespace

ServicePlan plan_services(const Situation& situation) { return ServicePlanner(situation).plan(); }

}  // namespace agnocast::bridge
