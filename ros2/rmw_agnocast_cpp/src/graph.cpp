// SPDX-License-Identifier: Apache-2.0
//
// The graph: nodes, topics, services and endpoints of the host, as the daemon's table has them at
// the moment of the call.

#include <ros2/rmw_agnocast_cpp/src/common.hpp>
#include <ros2/rmw_agnocast_cpp/src/endpoints.hpp>

#include <agnocast/service_name.hpp>

#include <rcutils/strdup.h>
#include <rmw/get_node_info_and_types.h>
#include <rmw/get_service_names_and_types.h>
#include <rmw/get_topic_endpoint_info.h>
#include <rmw/get_topic_names_and_types.h>
#include <rmw/names_and_types.h>
#include <rmw/sanity_checks.h>
#include <rmw/topic_endpoint_info_array.h>
#include <rmw/validate_full_topic_name.h>
#include <rmw/validate_namespace.h>
#include <rmw/validate_node_name.h>

#include <cstring>
#include <map>
#include <set>

using namespace agnocast;
using namespace agnocast::rmw;

namespace {

using NamesAndTypes = std::map<std::string, std::set<std::string>>;
using Kind = TopicRole::Kind;

/// Calls `see(endpoint, role)` for the endpoints of the node's domain.
template <class See>
void for_each_endpoint(const rmw_node_t* node, See see) {
  const auto snapshot = node->context->impl->graph().now();
  for (const EndpointInfo& endpoint : snapshot->endpoints) {
    if (endpoint.domain == node->context->actual_domain_id)
      see(endpoint, role_of_topic(endpoint.topic));
  }
}

/// The service of its requests: "example_interfaces/srv/AddTwoInts".
std::string service_type(const std::string& request) {
  constexpr std::string_view suffix = "_Request";
  return request.ends_with(suffix) ? request.substr(0, request.size() - suffix.size()) : request;
}

rmw_ret_t give(const NamesAndTypes& from, rcutils_allocator_t* allocator,
               rmw_names_and_types_t* to) {
  if (const rmw_ret_t made = rmw_names_and_types_init(to, from.size(), allocator);
      made != RMW_RET_OK)
    return made;
  const auto fill = [&] {
    std::size_t i = 0;
    for (const auto& [name, types] : from) {
      to->names.data[i] = rcutils_strdup(name.c_str(), *allocator);
      if (to->names.data[i] == nullptr ||
          rcutils_string_array_init(&to->types[i], types.size(), allocator) != RCUTILS_RET_OK)
        return false;
      std::size_t n = 0;
      for (const std::string& type : types) {
        to->types[i].data[n] = rcutils_strdup(type.c_str(), *allocator);
        if (to->types[i].data[n++] == nullptr) return false;
      }
      ++i;
    }
    return true;
  };
  if (fill()) return RMW_RET_OK;
  [[maybe_unused]] const rmw_ret_t ended = rmw_names_and_types_fini(to);
  return refuse(RMW_RET_BAD_ALLOC, "there is no memory left");
}

/// The checks of what asks for names and types.
rmw_ret_t check(const rmw_node_t* node, rcutils_allocator_t* allocator,
                rmw_names_and_types_t* names_and_types) {
  AGNOCAST_RMW_OURS(node);
  RCUTILS_CHECK_ALLOCATOR_WITH_MSG(allocator, "allocator argument is invalid",
                                   return RMW_RET_INVALID_ARGUMENT);
  return rmw_names_and_types_check_zero(names_and_types);
}

rmw_ret_t check_node(const char* name, const char* namespace_) {
  AGNOCAST_RMW_NOT_NULL(name);
  AGNOCAST_RMW_NOT_NULL(namespace_);
  int result = RMW_NODE_NAME_VALID;
  if (rmw_validate_node_name(name, &result, nullptr) != RMW_RET_OK || result != RMW_NODE_NAME_VALID)
    return refuse(RMW_RET_INVALID_ARGUMENT, "the name of the node is invalid");
  if (rmw_validate_namespace(namespace_, &result, nullptr) != RMW_RET_OK ||
      result != RMW_NAMESPACE_VALID)
    return refuse(RMW_RET_INVALID_ARGUMENT, "the namespace of the node is invalid");
  return RMW_RET_OK;
}

/// All nodes of the host with an endpoint, and those of this context, in the order of their names.
std::multiset<std::pair<std::string, std::string>> nodes_of(const rmw_node_t* node) {
  std::set<std::tuple<std::string, std::string, std::uint64_t>> seen;  // once in each process
  std::multiset<std::pair<std::string, std::string>> nodes;
  if (!node->context->impl->is_in_child()) {
    const std::lock_guard lock(node->context->impl->mutex);
    for (const NodeData* own : node->context->impl->nodes)
      nodes.emplace(own->name.name_space, own->name.name);
  }
  const std::set<std::pair<std::string, std::string>> own(nodes.begin(), nodes.end());
  for_each_endpoint(node, [&](const EndpointInfo& endpoint, const TopicRole&) {
    if (endpoint.is_own && own.count({endpoint.node_namespace, endpoint.node_name}) != 0) return;
    if (seen.emplace(endpoint.node_namespace, endpoint.node_name, endpoint.client).second)
      nodes.emplace(endpoint.node_namespace, endpoint.node_name);
  });
  return nodes;
}

rmw_ret_t names_by_node(const rmw_node_t* node, rcutils_allocator_t* allocator,
                        const char* node_name, const char* node_namespace,
                        rmw_names_and_types_t* to, Kind kind, EndpointKind of) {
  if (const rmw_ret_t wrong = check(node, allocator, to); wrong != RMW_RET_OK) return wrong;
  if (const rmw_ret_t wrong = check_node(node_name, node_namespace); wrong != RMW_RET_OK)
    return wrong;
  return guarded([&] {
    if (nodes_of(node).count({node_namespace, node_name}) == 0)
      return refuse(RMW_RET_NODE_NAME_NON_EXISTENT, "there is no node of this name");
    NamesAndTypes found;
    for_each_endpoint(node, [&](const EndpointInfo& endpoint, const TopicRole& role) {
      if (endpoint.kind != of || role.kind != kind || endpoint.node_name != node_name ||
          endpoint.node_namespace != node_namespace)
        return;
      if (kind == Kind::topic)
        found[endpoint.topic].insert(endpoint.type);
      else
        found[role.service].insert(service_type(endpoint.type));
    });
    return give(found, allocator, to);
  });
}

rmw_ret_t count(const rmw_node_t* node, const char* topic, EndpointKind kind, std::size_t* to) {
  AGNOCAST_RMW_OURS(node);
  AGNOCAST_RMW_NOT_NULL(topic);
  AGNOCAST_RMW_NOT_NULL(to);
  int result = RMW_TOPIC_VALID;
  if (rmw_validate_full_topic_name(topic, &result, nullptr) != RMW_RET_OK ||
      result != RMW_TOPIC_VALID)
    return refuse(RMW_RET_INVALID_ARGUMENT, "the name of the topic is invalid");
  return guarded([&] {
    std::size_t found = 0;
    for_each_endpoint(node, [&](const EndpointInfo& endpoint, const TopicRole&) {
      if (endpoint.kind == kind && endpoint.topic == topic) ++found;
    });
    *to = found;
    return rmw_ret_t{RMW_RET_OK};
  });
}

rmw_time_t time_of(std::chrono::nanoseconds time) {
  return time.count() == 0 ? rmw_time_t RMW_DURATION_INFINITE : rmw_time_from_nsec(time.count());
}

rmw_qos_profile_t profile_of(const QoS& qos) {
  rmw_qos_profile_t profile{};
  profile.history =
      qos.is_keep_all() ? RMW_QOS_POLICY_HISTORY_KEEP_ALL : RMW_QOS_POLICY_HISTORY_KEEP_LAST;
  profile.depth = qos.depth();
  profile.reliability = qos.is_reliable() ? RMW_QOS_POLICY_RELIABILITY_RELIABLE
                                          : RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
  profile.durability = qos.is_transient_local() ? RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL
                                                : RMW_QOS_POLICY_DURABILITY_VOLATILE;
  profile.deadline = time_of(qos.deadline());
  profile.lifespan = time_of(qos.lifespan());
  profile.liveliness = qos.liveliness() == Liveliness::manual_by_topic
                           ? RMW_QOS_POLICY_LIVELINESS_MANUAL_BY_TOPIC
                           : RMW_QOS_POLICY_LIVELINESS_AUTOMATIC;
  profile.liveliness_lease_duration = time_of(qos.liveliness_lease_duration());
  return profile;
}

rmw_ret_t set_all(rmw_topic_endpoint_info_t* info, const EndpointInfo& endpoint,
                  rcutils_allocator_t* allocator) {
  const bool is_publisher = endpoint.kind == EndpointKind::publisher;
  const rmw_gid_t gid = gid_of(endpoint.generation);
  const rmw_qos_profile_t qos = profile_of(endpoint.qos);
  for (const rmw_ret_t set :
       {rmw_topic_endpoint_info_set_node_name(info, endpoint.node_name.c_str(), allocator),
        rmw_topic_endpoint_info_set_node_namespace(info, endpoint.node_namespace.c_str(),
                                                   allocator),
        rmw_topic_endpoint_info_set_topic_type(info, endpoint.type.c_str(), allocator),
        rmw_topic_endpoint_info_set_endpoint_type(
            info, is_publisher ? RMW_ENDPOINT_PUBLISHER : RMW_ENDPOINT_SUBSCRIPTION),
        rmw_topic_endpoint_info_set_gid(info, gid.data, sizeof gid.data),
        rmw_topic_endpoint_info_set_qos_profile(info, &qos)}) {
    if (set != RMW_RET_OK) return set;
  }
  return RMW_RET_OK;
}

rmw_ret_t infos(const rmw_node_t* node, rcutils_allocator_t* allocator, const char* topic,
                EndpointKind kind, rmw_topic_endpoint_info_array_t* to) {
  AGNOCAST_RMW_OURS(node);
  RCUTILS_CHECK_ALLOCATOR_WITH_MSG(allocator, "allocator argument is invalid",
                                   return RMW_RET_INVALID_ARGUMENT);
  AGNOCAST_RMW_NOT_NULL(topic);
  if (rmw_topic_endpoint_info_array_check_zero(to) != RMW_RET_OK) return RMW_RET_INVALID_ARGUMENT;
  return guarded([&] {
    std::vector<EndpointInfo> found;
    for_each_endpoint(node, [&](const EndpointInfo& endpoint, const TopicRole&) {
      if (endpoint.kind == kind && endpoint.topic == topic) found.push_back(endpoint);
    });
    rmw_ret_t made = rmw_topic_endpoint_info_array_init_with_size(to, found.size(), allocator);
    for (std::size_t i = 0; i < found.size() && made == RMW_RET_OK; ++i)
      made = set_all(&to->info_array[i], found[i], allocator);
    if (made != RMW_RET_OK) {
      [[maybe_unused]] const rmw_ret_t ended = rmw_topic_endpoint_info_array_fini(to, allocator);
    }
    return made;
  });
}

rmw_ret_t node_names(const rmw_node_t* node, rcutils_string_array_t* names,
                     rcutils_string_array_t* namespaces, rcutils_string_array_t* enclaves) {
  AGNOCAST_RMW_OURS(node);
  for (rcutils_string_array_t* const array : {names, namespaces}) {
    if (rmw_check_zero_rmw_string_array(array) != RMW_RET_OK) return RMW_RET_INVALID_ARGUMENT;
  }
  if (enclaves != nullptr && rmw_check_zero_rmw_string_array(enclaves) != RMW_RET_OK)
    return RMW_RET_INVALID_ARGUMENT;
  return guarded([&] {
    const auto nodes = nodes_of(node);
    rcutils_allocator_t allocator = rcutils_get_default_allocator();
    bool is_made = true;
    const auto fill = [&](rcutils_string_array_t* array, auto text_of_node) {
      is_made =
          is_made && rcutils_string_array_init(array, nodes.size(), &allocator) == RCUTILS_RET_OK;
      std::size_t i = 0;
      for (const auto& one : nodes) {
        if (!is_made) return;
        array->data[i] = rcutils_strdup(text_of_node(one).c_str(), allocator);
        is_made = array->data[i++] != nullptr;
      }
    };
    fill(names, [](const auto& one) { return one.second; });
    fill(namespaces, [](const auto& one) { return one.first; });
    // The daemon does not know them; without SROS 2 all are in this one.
    if (enclaves != nullptr) fill(enclaves, [](const auto&) { return std::string("/"); });
    if (is_made) return rmw_ret_t{RMW_RET_OK};
    for (rcutils_string_array_t* const array : {names, namespaces, enclaves}) {
      if (array == nullptr) continue;
      [[maybe_unused]] const rcutils_ret_t ended = rcutils_string_array_fini(array);
    }
    throw std::bad_alloc();
  });
}

}  // namespace

extern "C" {

rmw_ret_t rmw_get_node_names(const rmw_node_t* node, rcutils_string_array_t* names,
                             rcutils_string_array_t* node_namespaces) {
  return node_names(node, names, node_namespaces, nullptr);
}
rmw_ret_t rmw_get_node_names_with_enclaves(const rmw_node_t* node, rcutils_string_array_t* names,
                                           rcutils_string_array_t* node_namespaces,
                                           rcutils_string_array_t* enclaves) {
  AGNOCAST_RMW_NOT_NULL(enclaves);
  return node_names(node, names, node_namespaces, enclaves);
}

rmw_ret_t rmw_count_publishers(const rmw_node_t* node, const char* topic_name, size_t* to) {
  return count(node, topic_name, EndpointKind::publisher, to);
}
rmw_ret_t rmw_count_subscribers(const rmw_node_t* node, const char* topic_name, size_t* to) {
  return count(node, topic_name, EndpointKind::subscription, to);
}

rmw_ret_t rmw_get_topic_names_and_types(const rmw_node_t* node, rcutils_allocator_t* allocator,
                                        bool no_demangle, rmw_names_and_types_t* to) {
  if (const rmw_ret_t wrong = check(node, allocator, to); wrong != RMW_RET_OK) return wrong;
  return guarded([&] {
    NamesAndTypes found;
    for_each_endpoint(node, [&](const EndpointInfo& endpoint, const TopicRole& role) {
      if (no_demangle || role.kind == Kind::topic) found[endpoint.topic].insert(endpoint.type);
    });
    return give(found, allocator, to);
  });
}
rmw_ret_t rmw_get_service_names_and_types(const rmw_node_t* node, rcutils_allocator_t* allocator,
                                          rmw_names_and_types_t* to) {
  if (const rmw_ret_t wrong = check(node, allocator, to); wrong != RMW_RET_OK) return wrong;
  return guarded([&] {
    NamesAndTypes found;
    for_each_endpoint(node, [&](const EndpointInfo& endpoint, const TopicRole& role) {
      if (role.kind == Kind::request) found[role.service].insert(service_type(endpoint.type));
    });
    return give(found, allocator, to);
  });
}

rmw_ret_t rmw_get_subscriber_names_and_types_by_node(const rmw_node_t* node,
                                                     rcutils_allocator_t* allocator,
                                                     const char* node_name,
                                                     const char* node_namespace, bool,
                                                     rmw_names_and_types_t* to) {
  return names_by_node(node, allocator, node_name, node_namespace, to, Kind::topic,
                       EndpointKind::subscription);
}
rmw_ret_t rmw_get_publisher_names_and_types_by_node(const rmw_node_t* node,
                                                    rcutils_allocator_t* allocator,
                                                    const char* node_name,
                                                    const char* node_namespace, bool,
                                                    rmw_names_and_types_t* to) {
  return names_by_node(node, allocator, node_name, node_namespace, to, Kind::topic,
                       EndpointKind::publisher);
}
rmw_ret_t rmw_get_service_names_and_types_by_node(const rmw_node_t* node,
                                                  rcutils_allocator_t* allocator,
                                                  const char* node_name, const char* node_namespace,
                                                  rmw_names_and_types_t* to) {
  return names_by_node(node, allocator, node_name, node_namespace, to, Kind::request,
                       EndpointKind::subscription);
}
rmw_ret_t rmw_get_client_names_and_types_by_node(const rmw_node_t* node,
                                                 rcutils_allocator_t* allocator,
                                                 const char* node_name, const char* node_namespace,
                                                 rmw_names_and_types_t* to) {
  return names_by_node(node, allocator, node_name, node_namespace, to, Kind::request,
                       EndpointKind::publisher);
}

rmw_ret_t rmw_get_publishers_info_by_topic(const rmw_node_t* node, rcutils_allocator_t* allocator,
                                           const char* topic_name, bool,
                                           rmw_topic_endpoint_info_array_t* publishers_info) {
  return infos(node, allocator, topic_name, EndpointKind::publisher, publishers_info);
}
rmw_ret_t rmw_get_subscriptions_info_by_topic(const rmw_node_t* node,
                                              rcutils_allocator_t* allocator,
                                              const char* topic_name, bool,
                                              rmw_topic_endpoint_info_array_t* subscriptions_info) {
  return infos(node, allocator, topic_name, EndpointKind::subscription, subscriptions_info);
}

}  // extern "C"
