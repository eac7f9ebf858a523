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
agnocast::QoS override_qos(Node& node, const std::string& topic,
                           const rclcpp::QosOverridingOptions& options, const agnocast::QoS& qos,
                           EntityTraits traits) {
  if (options.get_policy_kinds().empty()) return qos;
  rclcpp::QoS given(qos.depth());
  if (qos.is_keep_all()) given.keep_all();
  if (!qos.is_reliable()) given.best_effort();
  if (qos.is_transient_local()) given.transient_local();
  return rclcpp::detail::declare_qos_parameters(options, node, topic, given, traits);
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
    qos = agnocast_rclcpp::override_qos(node, name.topic, options.ros.qos_overriding_options, qos,
                                        rclcpp::detail::SubscriptionQosParametersTraits());
    auto translated = agnocast_rclcpp::translate(options, name.topic, node.get_logger(),
                                                 *node.get_node_base_interface());
    agnocast_rclcpp::allow_queue(translated, qos.depth());
    return with_group(node, options.ros.callback_group, std::move(translated));
  }
  static Result<core::PublisherOptions> options(Node& node, const EndpointName& name, QoS& qos,
                                                const PublisherOptions& options) {
    qos = agnocast_rclcpp::override_qos(node, name.topic, options.ros.qos_overriding_options, qos,
                                        rclcpp::detail::PublisherQosParametersTraits());
    return with_group(node, options.ros.callback_group,
                      agnocast_rclcpp::translate(options, name.topic, node.get_logger()));
  }

 private:
  template <class Options>
  static Result<Options> with_group(Node& node, const Group& named, Options options) {
    auto adapted = group(node, named);
    if (!adapted) return tl::unexpected<Failure>(adapted.error());
    options.callback_group(std::move(*adapted));
    return options;
  }
};

}  // namespace agnocast::detail
