// SPDX-License-Identifier: Apache-2.0
//
// agnocast::Node is an rclcpp::Node, with the names of the kernel-module system: parameters, clock,
// logging and the rest are rclcpp's. So it takes part in DDS, unless the rmw implementation does
// not use DDS.
#pragma once

#include <agnocast/agnocast_client.hpp>
#include <agnocast/agnocast_publisher.hpp>
#include <agnocast/agnocast_service.hpp>
#include <agnocast/agnocast_subscription.hpp>
#include <agnocast/agnocast_timer.hpp>
#include <agnocast/node/agnocast_context.hpp>

#include <rcl_interfaces/msg/parameter_descriptor.hpp>
#include <rclcpp/rclcpp.hpp>

#include <chrono>
#include <cstddef>
#include <memory>
#include <string>
#include <utility>

namespace agnocast {

using ParameterDescriptor = rcl_interfaces::msg::ParameterDescriptor;

/// Functions that are not declared here are those of rclcpp::Node.
class Node : public rclcpp::Node {
 public:
  RCLCPP_SMART_PTR_DEFINITIONS(Node)
  using ParameterValue = rclcpp::ParameterValue;
  using OnSetParametersCallbackHandle = rclcpp::node_interfaces::OnSetParametersCallbackHandle;
  using OnSetParametersCallbackType = decltype(OnSetParametersCallbackHandle::callback);

  /// As those of rclcpp::Node. init() comes first.
  explicit Node(const std::string& node_name,
                const rclcpp::NodeOptions& options = rclcpp::NodeOptions())
      : rclcpp::Node(node_name, options) {}
  Node(const std::string& node_name, const std::string& node_namespace,
       const rclcpp::NodeOptions& options = rclcpp::NodeOptions())
      : rclcpp::Node(node_name, node_namespace, options) {}

  std::string get_name() const { return rclcpp::Node::get_name(); }
  std::string get_namespace() const { return rclcpp::Node::get_namespace(); }
  std::string get_fully_qualified_name() const { return rclcpp::Node::get_fully_qualified_name(); }

  /// Return the number of publishers or subscriptions of agnocast on this host, in this ROS domain,
  /// as agnocast::Graph::wait() has them; those of agnocast-bridge, which stand for DDS, count as
  /// well. The first call of a process may wait five seconds for agnocastd; while that is away, the
  /// last state counts. Throw Error.
  std::size_t count_publishers(const std::string& topic_name) const;
  std::size_t count_subscribers(const std::string& topic_name) const;

  /// These are the functions of <agnocastlib/create.hpp> for this node. They throw Error.
  template <class MessageT>
  typename Publisher<MessageT>::SharedPtr create_publisher(const std::string& topic_name,
                                                           const rclcpp::QoS& qos,
                                                           const PublisherOptions& options = {}) {
    return std::make_shared<Publisher<MessageT>>(this, topic_name, qos, options);
  }
  template <class MessageT>
  typename Publisher<MessageT>::SharedPtr create_publisher(const std::string& topic_name,
                                                           std::size_t depth,
                                                           const PublisherOptions& options = {}) {
    return create_publisher<MessageT>(topic_name, rclcpp::QoS(rclcpp::KeepLast(depth)), options);
  }
  template <class MessageT, class Func>
  typename Subscription<MessageT>::SharedPtr create_subscription(
      const std::string& topic_name, const rclcpp::QoS& qos, Func&& callback,
      const SubscriptionOptions& options = {}) {
    return std::make_shared<Subscription<MessageT>>(this, topic_name, qos,
                                                    std::forward<Func>(callback), options);
  }
  template <class MessageT, class Func>
  typename Subscription<MessageT>::SharedPtr create_subscription(
      const std::string& topic_name, std::size_t depth, Func&& callback,
      const SubscriptionOptions& options = {}) {
    return create_subscription<MessageT>(topic_name, rclcpp::QoS(rclcpp::KeepLast(depth)),
                                         std::forward<Func>(callback), options);
  }
  template <class MessageT>
  typename PollingSubscriber<MessageT>::SharedPtr create_subscription(const std::string& topic_name,
                                                                      const rclcpp::QoS& qos) {
    return std::make_shared<PollingSubscriber<MessageT>>(this, topic_name, qos);
  }
  template <class MessageT>
  typename PollingSubscriber<MessageT>::SharedPtr create_subscription(const std::string& topic_name,
                                                                      std::size_t depth) {
    return create_subscription<MessageT>(topic_name, rclcpp::QoS(rclcpp::KeepLast(depth)));
  }
  template <class ServiceT>
  typename Client<ServiceT>::SharedPtr create_client(
      const std::string& service_name, const rclcpp::QoS& qos = rclcpp::ServicesQoS(),
      rclcpp::CallbackGroup::SharedPtr group = nullptr) {
    return std::make_shared<Client<ServiceT>>(this, service_name, qos, std::move(group));
  }
  template <class ServiceT, class Func>
  typename Service<ServiceT>::SharedPtr create_service(
      const std::string& service_name, Func&& callback,
      const rclcpp::QoS& qos = rclcpp::ServicesQoS(),
      rclcpp::CallbackGroup::SharedPtr group = nullptr) {
    return std::make_shared<Service<ServiceT>>(this, service_name, std::forward<Func>(callback),
                                               qos, std::move(group));
  }

  /// `autostart` false: the timer begins with TimerBase::reset().
  template <class Rep = std::int64_t, class Period = std::milli, class CallbackT>
  typename WallTimer<CallbackT>::SharedPtr create_wall_timer(
      std::chrono::duration<Rep, Period> period, CallbackT callback,
      rclcpp::CallbackGroup::SharedPtr group = nullptr, bool autostart = true) {
    return start(std::make_shared<WallTimer<CallbackT>>(std::move(callback)), period, group,
                 autostart);
  }
  /// A timer of the node's clock.
  template <class Rep = std::int64_t, class Period = std::milli, class CallbackT>
  typename GenericTimer<CallbackT>::SharedPtr create_timer(
      std::chrono::duration<Rep, Period> period, CallbackT callback,
      rclcpp::CallbackGroup::SharedPtr group = nullptr, bool autostart = true) {
    return start(std::make_shared<GenericTimer<CallbackT>>(get_clock(), std::move(callback)),
                 period, group, autostart);
  }
  template <class Rep, class Period, class CallbackT>
  [[deprecated("use agnocast::create_timer()")]] typename GenericTimer<CallbackT>::SharedPtr
  create_timer(std::chrono::duration<Rep, Period> period, CallbackT callback,
               rclcpp::CallbackGroup::SharedPtr group, rclcpp::Clock::SharedPtr clock) {
    return start(std::make_shared<GenericTimer<CallbackT>>(std::move(clock), std::move(callback)),
                 period, group, true);
  }

  /// They do not compile: those of rclcpp::Node would be endpoints of DDS.
  template <class... Arguments>
  void create_generic_publisher(Arguments&&...) {
    static_assert(never<Arguments...>,
                  "agnocast: agnocastlib has no generic publishers; see "
                  "agnocast_rclcpp, or use rclcpp::Node for one of DDS");
  }
  template <class... Arguments>
  void create_generic_subscription(Arguments&&...) {
    static_assert(never<Arguments...>,
                  "agnocast: agnocastlib has no generic subscriptions; see "
                  "agnocast_rclcpp, or use rclcpp::Node for one of DDS");
  }

 private:
  template <class...>
  static constexpr bool never = false;

  template <class Timer, class Rep, class Period>
  std::shared_ptr<Timer> start(std::shared_ptr<Timer> timer,
                               std::chrono::duration<Rep, Period> period,
                               const rclcpp::CallbackGroup::SharedPtr& group, bool autostart) {
    TimerBase::start(timer, std::chrono::duration_cast<std::chrono::nanoseconds>(period), autostart,
                     get_node_base_interface(), get_node_timers_interface(), group);
    return timer;
  }
};

}  // namespace agnocast
