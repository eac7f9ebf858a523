// SPDX-License-Identifier: Apache-2.0
//
// NodeAdapter: the types of options, callback groups and message info that the create_… functions
// take with a node: this library's, or those of the node's own library.
#pragma once

#include <agnocast/callback_group.hpp>
#include <agnocast/core_namespace.hpp>
#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/node_like.hpp>
#include <agnocast/result.hpp>

#include <functional>
#include <type_traits>
#include <utility>

namespace agnocast {

AGNOCAST_CORE_BEGIN
class PublisherOptions;
class SubscriptionOptions;
AGNOCAST_CORE_END

namespace detail {

/// For the nodes of rclcpp, a package specializes this.
template <class Node, class = void>
struct NodeAdapter {
  static_assert(!is_rclcpp_node<Node>,
                "agnocast: the callbacks of an rclcpp node run in rclcpp's executors: include "
                "<agnocast_rclcpp/agnocast_rclcpp.hpp>, of the package agnocast_rclcpp");
  using Group = CallbackGroup::SharedPtr;
  using PublisherOptions = core::PublisherOptions;
  using SubscriptionOptions = core::SubscriptionOptions;
  /// A type that callbacks may take besides agnocast::MessageInfo.
  using Info = MessageInfo;
  static const Info& info(const MessageInfo& info) noexcept { return info; }
  static Result<Group> group(const Node&, const Group& named) { return named; }
  /// Returns what tells that nothing is worth waiting for any more; empty: nothing does.
  static std::function<bool()> is_over(const Node&) noexcept { return {}; }
  /// May change the QoS.
  template <class Options, class Qos>
  static Result<Options> options(const Node&, const EndpointName&, Qos&, const Options& options) {
    return options;
  }
};

template <class Node>
using AdapterOf = NodeAdapter<NodeOf<Node>>;
template <class Node>
using GroupOf = typename AdapterOf<Node>::Group;
template <class Node>
using PublisherOptionsOf = typename AdapterOf<Node>::PublisherOptions;
template <class Node>
using SubscriptionOptionsOf = typename AdapterOf<Node>::SubscriptionOptions;

}  // namespace detail
}  // namespace agnocast
