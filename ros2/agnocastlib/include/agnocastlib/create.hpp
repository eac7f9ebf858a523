// SPDX-License-Identifier: Apache-2.0
//
// The free functions that create endpoints and timers, for an rclcpp::Node or an agnocast::Node.
#pragma once

#include <agnocast/agnocast_client.hpp>
#include <agnocast/agnocast_publisher.hpp>
#include <agnocast/agnocast_service.hpp>
#include <agnocast/agnocast_subscription.hpp>
#include <agnocast/agnocast_timer.hpp>

#include <rclcpp/rclcpp.hpp>

#include <cstddef>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>

namespace agnocast {

/// All throw Error: daemon_not_running, hook_missing, invalid_name, … (agnocast/error.hpp). Where
/// the kernel-module system would end the process, an exception that nobody catches does.
template <class MessageT, class NodeT>
typename Publisher<MessageT>::SharedPtr create_publisher(NodeT* node, const std::string& topic_name,
                                                         const rclcpp::QoS& qos,
                                                         const PublisherOptions& options = {}) {
  return std::make_shared<Publisher<MessageT>>(node, topic_name, qos, options);
}
template <class MessageT, class NodeT>
typename Publisher<MessageT>::SharedPtr create_publisher(NodeT* node, const std::string& topic_name,
                                                         std::size_t qos_history_depth,
                                                         const PublisherOptions& options = {}) {
  return create_publisher<MessageT>(node, topic_name,
                                    rclcpp::QoS(rclcpp::KeepLast(qos_history_depth)), options);
}

template <class MessageT, class NodeT, class Func>
typename Subscription<MessageT>::SharedPtr create_subscription(
    NodeT* node, const std::string& topic_name, const rclcpp::QoS& qos, Func&& callback,
    const SubscriptionOptions& options = {}) {
  return std::make_shared<Subscription<MessageT>>(node, topic_name, qos,
                                                  std::forward<Func>(callback), options);
}
template <class MessageT, class NodeT, class Func>
typename Subscription<MessageT>::SharedPtr create_subscription(
    NodeT* node, const std::string& topic_name, std::size_t qos_history_depth, Func&& callback,
    const SubscriptionOptions& options = {}) {
  return create_subscription<MessageT>(node, topic_name,
                                       rclcpp::QoS(rclcpp::KeepLast(qos_history_depth)),
                                       std::forward<Func>(callback), options);
}
/// Without a callback.
template <class MessageT, class NodeT>
typename PollingSubscriber<MessageT>::SharedPtr create_subscription(NodeT* node,
                                                                    const std::string& topic_name,
                                                                    const rclcpp::QoS& qos) {
  return std::make_shared<PollingSubscriber<MessageT>>(node, topic_name, qos);
}
template <class MessageT, class NodeT>
typename PollingSubscriber<MessageT>::SharedPtr create_subscription(NodeT* node,
                                                                    const std::string& topic_name,
                                                                    std::size_t qos_history_depth) {
  return create_subscription<MessageT>(node, topic_name,
                                       rclcpp::QoS(rclcpp::KeepLast(qos_history_depth)));
}

template <class ServiceT, class NodeT>
typename Client<ServiceT>::SharedPtr create_client(
    NodeT* node, const std::string& service_name, const rclcpp::QoS& qos = rclcpp::ServicesQoS(),
    rclcpp::CallbackGroup::SharedPtr group = nullptr) {
  return std::make_shared<Client<ServiceT>>(node, service_name, qos, std::move(group));
}
template <class ServiceT, class NodeT, class Func>
typename Service<ServiceT>::SharedPtr create_service(
    NodeT* node, const std::string& service_name, Func&& callback,
    const rclcpp::QoS& qos = rclcpp::ServicesQoS(),
    rclcpp::CallbackGroup::SharedPtr group = nullptr) {
  return std::make_shared<Service<ServiceT>>(node, service_name, std::forward<Func>(callback), qos,
                                             std::move(group));
}

/// Creates a timer of `clock`; a ROS clock follows simulated time. `node`: a pointer or shared
/// pointer. `callback` takes nothing, or TimerBase&. `autostart` false: the timer begins with
/// TimerBase::reset(). Throws std::invalid_argument: no clock, or a negative period.
template <class NodeT, class CallbackT>
TimerBase::SharedPtr create_timer(NodeT node, rclcpp::Clock::SharedPtr clock,
                                  rclcpp::Duration period, CallbackT&& callback,
                                  rclcpp::CallbackGroup::SharedPtr group = nullptr,
                                  bool autostart = true) {
  auto timer = std::make_shared<GenericTimer<std::decay_t<CallbackT>>>(
      std::move(clock), std::forward<CallbackT>(callback));
  TimerBase::start(timer, period.to_chrono<std::chrono::nanoseconds>(), autostart,
                   node->get_node_base_interface(), node->get_node_timers_interface(), group);
  return timer;
}

}  // namespace agnocast
