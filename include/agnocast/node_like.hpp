// SPDX-License-Identifier: Apache-2.0
//
// What the library needs of a node: a name, a namespace, and how topic names resolve. An
// rclcpp::Node, an agnocast::Node or anything of that shape fits, by reference, pointer or shared
// pointer; nothing here depends on rclcpp.
#pragma once

#include <agnocast/export.hpp>
#include <agnocast/result.hpp>

#include <exception>
#include <new>
#include <string>
#include <type_traits>
#include <utility>

namespace agnocast::detail {

/// An endpoint's place in the ROS graph, fully qualified.
struct EndpointName {
  std::string topic;
  std::string node;
};

/// ROS rules: relative names get the namespace, "~" the node's name. Errors: invalid_name.
[[nodiscard]] AGNOCAST_PUBLIC Result<std::string> expand_topic(const std::string& topic,
                                                               const std::string& node_name,
                                                               const std::string& node_namespace);
/// Errors: invalid_name.
[[nodiscard]] AGNOCAST_PUBLIC Result<void> require_topic(const std::string& topic);

template <class Node, class = void>
inline constexpr bool has_topics_interface = false;
template <class Node>
inline constexpr bool has_topics_interface<
    Node,
    std::void_t<decltype(std::declval<Node&>().get_node_topics_interface()->resolve_topic_name(
        std::string()))>> = true;
template <class Node, class = void>
inline constexpr bool has_try_resolve = false;
template <class Node>
inline constexpr bool has_try_resolve<
    Node, std::void_t<decltype(std::declval<Node&>().try_resolve_topic_name(std::string()))>> =
    true;
template <class Node, class = void>
inline constexpr bool has_resolve = false;
template <class Node>
inline constexpr bool has_resolve<
    Node, std::void_t<decltype(std::declval<Node&>().resolve_topic_name(std::string()))>> = true;

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

/// Resolves `topic` as `node` would: its remappings if it has any, else by the rules alone.
template <class Node>
[[nodiscard]] Result<EndpointName> resolve(Node& node, const std::string& topic) {
  EndpointName name;
  name.node = node.get_fully_qualified_name();
  const auto ask = [&](auto& names) -> Result<void> {
    try {
      name.topic = names.resolve_topic_name(topic);
      return {};
    } catch (const std::bad_alloc&) {
      throw;
    } catch (const std::exception& refused) {  // rclcpp's, of a wrong name
      return fail_with(Errc::invalid_name, refused.what());
    }
  };
  if constexpr (has_try_resolve<Node>) {
    Result<std::string> resolved = node.try_resolve_topic_name(topic);
    if (!resolved) return tl::unexpected<Failure>(resolved.error());
    name.topic = std::move(*resolved);
  } else if constexpr (has_topics_interface<Node>) {
    const auto names = node.get_node_topics_interface();
    if (Result<void> done = ask(*names); !done) return tl::unexpected<Failure>(done.error());
  } else if constexpr (has_resolve<Node>) {
    if (Result<void> done = ask(node); !done) return tl::unexpected<Failure>(done.error());
  } else {
    Result<std::string> expanded = expand_topic(topic, node.get_name(), node.get_namespace());
    if (!expanded) return tl::unexpected<Failure>(expanded.error());
    name.topic = std::move(*expanded);
  }
  if (Result<void> valid = require_topic(name.topic); !valid)
    return tl::unexpected<Failure>(valid.error());
  return name;
}

}  // namespace agnocast::detail
