// SPDX-License-Identifier: Apache-2.0
//
// The library's requirements on a node: a name, a namespace, and resolution of topic names. An
// rclcpp::Node, an agnocast::Node or any class of that shape fits, by reference, pointer or
// shared pointer; nothing here depends on rclcpp.
#pragma once

#include <agnocast/exceptions.hpp>
#include <agnocast/export.hpp>
#include <agnocast/result.hpp>

#include <cstdint>
#include <exception>
#include <new>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>

namespace agnocast::detail {

/// An endpoint's place in the ROS graph, fully qualified.
struct EndpointName {
  std::string topic;
  std::string node;
  /// Persistent endpoint id: peers identify the endpoint by it as long as it lives, also across
  /// losses of the daemon. Several endpoints of one owner may share it. 0: generate a unique one.
  std::uint64_t persistent_id = 0;
  /// For a publisher: peers learn the id only after announce_persistent_id().
  bool announces_persistent_id_later = false;
  /// ROS domain; none: that of the process (domain_id()).
  std::optional<std::uint64_t> domain = {};
};

/// Applies the ROS rules: relative names get the namespace, "~" the node's name. Errors:
/// invalid_name.
[[nodiscard]] AGNOCAST_PUBLIC Result<std::string> expand_topic(const std::string& topic,
                                                               const std::string& node_name,
                                                               const std::string& node_namespace);
/// Checks a fully qualified name. Errors: invalid_name.
[[nodiscard]] AGNOCAST_PUBLIC Result<void> require_topic(const std::string& topic);
/// The same for the names of services.
[[nodiscard]] AGNOCAST_PUBLIC Result<std::string> expand_service(const std::string& service,
                                                                 const std::string& node_name,
                                                                 const std::string& node_namespace);
[[nodiscard]] AGNOCAST_PUBLIC Result<void> require_service(const std::string& service);

template <class Node, class = void>
inline constexpr bool is_pointer_like = false;
template <class Node>
inline constexpr bool is_pointer_like<Node, std::void_t<decltype(*std::declval<Node&>())>> = true;

template <class Node>
auto& dereference(Node& node) noexcept {
  if constexpr (is_pointer_like<Node>) {
    return *node;
  } else {
    return node;
  }
}

/// The type of the node itself, for a node by reference, pointer or shared pointer.
template <class Node>
using NodeOf =
    std::remove_cv_t<std::remove_reference_t<decltype(dereference(std::declval<Node&>()))>>;

template <class Node, class = void>
inline constexpr bool has_base_interface = false;
template <class Node>
inline constexpr bool has_base_interface<
    Node, std::void_t<decltype(std::declval<Node&>().get_node_base_interface())>> = true;
template <class Node, class = void>
inline constexpr bool is_base_interface = false;
template <class Node>
inline constexpr bool
    is_base_interface<Node, std::void_t<decltype(std::declval<Node&>().get_rcl_node_handle())>> =
        true;
/// True if rclcpp's callback groups and executors run the callbacks of this node type: an
/// rclcpp::Node, a lifecycle node, or the interface that rclcpp's executors take.
template <class Node>
inline constexpr bool is_rclcpp_node = has_base_interface<Node> || is_base_interface<Node>;

template <class Node, class = void>
inline constexpr bool has_sub_namespace = false;
template <class Node>
inline constexpr bool
    has_sub_namespace<Node, std::void_t<decltype(std::declval<Node&>().get_sub_namespace())>> =
        true;

/// Returns the fully qualified name; a lifecycle node has it in its base interface only.
template <class Node>
std::string name_of(Node& node) {
  if constexpr (has_base_interface<Node>) {
    return node.get_node_base_interface()->get_fully_qualified_name();
  } else {
    return node.get_fully_qualified_name();
  }
}
/// Returns `name` as an rclcpp node made by create_sub_node() means it.
template <class Node>
std::string in_sub_namespace(Node& node, const std::string& name) {
  if constexpr (has_sub_namespace<Node>) {
    const std::string prefix = node.get_sub_namespace();
    const bool is_relative = !name.empty() && name.front() != '/' && name.front() != '~';
    if (is_relative && !prefix.empty()) return prefix + '/' + name;
  }
  return name;
}

/// How to get the full name of a topic, or of a service, from a node: through the interface of an
/// rclcpp::Node, a member that returns a Result, or one that throws; else by the rules alone.
struct TopicNames {
  template <class Node>
  static auto interface_of(Node& node) -> decltype(node.get_node_topics_interface()) {
    return node.get_node_topics_interface();
  }
  template <class Names>
  static auto resolve(Names& names, const std::string& name)
      -> decltype(names.resolve_topic_name(name)) {
    return names.resolve_topic_name(name);
  }
  template <class Node>
  static auto try_resolve(Node& node, const std::string& name)
      -> decltype(node.try_resolve_topic_name(name)) {
    return node.try_resolve_topic_name(name);
  }
  static constexpr auto expand = &expand_topic;
  static constexpr auto require = &require_topic;
};
struct ServiceNames {
  template <class Node>
  static auto interface_of(Node& node) -> decltype(node.get_node_services_interface()) {
    return node.get_node_services_interface();
  }
  template <class Names>
  static auto resolve(Names& names, const std::string& name)
      -> decltype(names.resolve_service_name(name)) {
    return names.resolve_service_name(name);
  }
  template <class Node>
  static auto try_resolve(Node& node, const std::string& name)
      -> decltype(node.try_resolve_service_name(name)) {
    return node.try_resolve_service_name(name);
  }
  static constexpr auto expand = &expand_service;
  static constexpr auto require = &require_service;
};

template <class Names, class Node, class = void>
inline constexpr bool has_interface = false;
template <class Names, class Node>
inline constexpr bool
    has_interface<Names, Node,
                  std::void_t<decltype(Names::resolve(*Names::interface_of(std::declval<Node&>()),
                                                      std::string()))>> = true;
template <class Names, class Node, class = void>
inline constexpr bool has_try_resolve = false;
template <class Names, class Node>
inline constexpr bool has_try_resolve<
    Names, Node, std::void_t<decltype(Names::try_resolve(std::declval<Node&>(), std::string()))>> =
    true;
template <class Names, class Node, class = void>
inline constexpr bool has_resolve = false;
template <class Names, class Node>
inline constexpr bool has_resolve<
    Names, Node, std::void_t<decltype(Names::resolve(std::declval<Node&>(), std::string()))>> =
    true;

template <class Node, class = void>
inline constexpr bool has_domain = false;
template <class Node>
inline constexpr bool
    has_domain<Node, std::void_t<decltype(std::declval<Node&>().get_domain_id())>> = true;
template <class Node, class = void>
inline constexpr bool has_context_domain = false;
template <class Node>
inline constexpr bool has_context_domain<Node, std::void_t<decltype(std::declval<Node&>()
                                                                        .get_node_base_interface()
                                                                        ->get_context()
                                                                        ->get_domain_id())>> = true;

/// Returns the ROS domain of a node that has one of its own; an rclcpp::Node has its context's.
template <class Node>
std::optional<std::uint64_t> domain_of(Node& node) {
  if constexpr (has_domain<Node>) {
    return node.get_domain_id();
  } else if constexpr (has_context_domain<Node>) {
    const auto context = node.get_node_base_interface()->get_context();
    if (context->is_valid()) return context->get_domain_id();
  }
  return std::nullopt;
}

/// Resolves `name` as `node` would: with its remappings if it has any, else by the rules alone.
template <class Names, class Node>
[[nodiscard]] Result<EndpointName> resolve_as(Node& node, const std::string& of_node) {
  EndpointName resolved;
  resolved.node = name_of(node);
  resolved.domain = domain_of(node);
  const std::string name = in_sub_namespace(node, of_node);
  const auto ask = [&](auto& names) -> Result<void> {
#if defined(__cpp_exceptions)
    try {
      resolved.topic = Names::resolve(names, name);
    } catch (const std::bad_alloc&) {
      throw;
    } catch (const std::exception& refused) {  // from rclcpp, for an invalid name
      return fail_with(Errc::invalid_name, "'" + name + "': " + refused.what());
    }
#else
    resolved.topic = Names::resolve(names, name);
#endif
    return {};
  };
  if constexpr (has_try_resolve<Names, Node>) {
    Result<std::string> full = Names::try_resolve(node, name);
    if (!full) return tl::unexpected<Failure>(full.error());
    resolved.topic = std::move(*full);
  } else if constexpr (has_interface<Names, Node>) {
    const auto names = Names::interface_of(node);
    if (Result<void> done = ask(*names); !done) return tl::unexpected<Failure>(done.error());
  } else if constexpr (has_resolve<Names, Node>) {
    if (Result<void> done = ask(node); !done) return tl::unexpected<Failure>(done.error());
  } else {
    Result<std::string> full = Names::expand(name, node.get_name(), node.get_namespace());
    if (!full) return tl::unexpected<Failure>(full.error());
    resolved.topic = std::move(*full);
  }
  if (Result<void> valid = Names::require(resolved.topic); !valid)
    return tl::unexpected<Failure>(valid.error());
  return resolved;
}
template <class Node>
[[nodiscard]] Result<EndpointName> resolve(Node& node, const std::string& topic) {
  return resolve_as<TopicNames>(node, topic);
}
template <class Node>
[[nodiscard]] Result<EndpointName> resolve_service(Node& node, const std::string& service) {
  return resolve_as<ServiceNames>(node, service);
}

}  // namespace agnocast::detail
