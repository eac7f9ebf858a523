// SPDX-License-Identifier: Apache-2.0
//
// How the create_… functions treat an rclcpp node: see <agnocast/node_adapter.hpp>.
#pragma once

#include <agnocast/node_adapter.hpp>
#include <agnocast/qos.hpp>
#include <agnocast/result.hpp>
#include <agnocast_rclcpp/callback_group.hpp>
#include <agnocast_rclcpp/options.hpp>

#include <rclcpp/context.hpp>
#include <rclcpp/detail/qos_parameters.hpp>
#include <rclcpp/message_info.hpp>
#include <rclcpp/qos.hpp>

#include <functional>
#include <string>
#include <type_traits>
#include <utility>

namespace agnocast_rclcpp {

/// Returns rclcpp's form. The publisher's GID identifies it on this host while the daemon lives;
/// the time of receipt is the present one. Costs three clock reads.
rclcpp::MessageInfo to_ros(const agnocast::MessageInfo& info);

/// Applies overrides by parameters, which it declares, as rclcpp does: qos_overrides.<topic>.….
template <class Node, class EntityTraits>
void override_qos(Node& node, const std::string& topic, const rclcpp::QosOverridingOptions& options,
                  agnocast::QoS& qos, EntityTraits traits) {
  if (!options.get_policy_kinds().empty()) {
    qos = rclcpp::detail::declare_qos_parameters(options, node, topic, rclcpp::QoS(qos), traits);
  }
}

}  // namespace agnocast_rclcpp

namespace agnocast::detail {

template <class Node>
struct NodeAdapter<Node, std::enable_if_t<is_rclcpp_node<Node>>> {
  using Group = rclcpp::CallbackGroup::SharedPtr;
  using PublisherOptions = agnocast_rclcpp::PublisherOptions;
  using SubscriptionOptions = agnocast_rclcpp::SubscriptionOptions;
  using Info = rclcpp::MessageInfo;

  static Info info(const MessageInfo& info) { return agnocast_rclcpp::to_ros(info); }
  static Result<CallbackGroup::SharedPtr> group(Node& node, const Group& named) {
    return agnocast_rclcpp::adapt_group(node.get_node_base_interface(),
                                        node.get_node_waitables_interface(), named);
  }
  static std::function<bool()> is_over(Node& node) {
    return
        [context = node.get_node_base_interface()->get_context()] { return !context->is_valid(); };
  }
  static Result<core::SubscriptionOptions> options(Node& node, const EndpointName& name, QoS& qos,
                                                   const SubscriptionOptions& options) {
    auto adapted = group(node, options.ros.callback_group);
    if (!adapted) return tl::unexpected<Failure>(adapted.error());
    agnocast_rclcpp::override_qos(node, name.topic, options.ros.qos_overriding_options, qos,
                                  rclcpp::detail::SubscriptionQosParametersTraits());
    auto translated = agnocast_rclcpp::translate(options, name.topic, node.get_logger(),
                                                 *node.get_node_base_interface());
    agnocast_rclcpp::allow_queue(translated, qos.depth());
    translated.callback_group(std::move(*adapted));
    return translated;
  }
  static Result<core::PublisherOptions> options(Node& node, const EndpointName& name, QoS& qos,
                                                const PublisherOptions& options) {
    auto adapted = group(node, options.ros.callback_group);
    if (!adapted) return tl::unexpected<Failure>(adapted.error());
    agnocast_rclcpp::override_qos(node, name.topic, options.ros.qos_overriding_options, qos,
                                  rclcpp::detail::PublisherQosParametersTraits());
    auto translated = agnocast_rclcpp::translate(options, name.topic, node.get_logger());
    translated.callback_group(std::move(*adapted));
    return translated;
  }
};

}  // namespace agnocast::detail
