// SPDX-License-Identifier: Apache-2.0
//
// A source for the filters and synchronizers of the package message_filters, which must be linked.
// Its messages are the publisher's memory, held as long as a filter keeps them. Sources of rclcpp's
// (::message_filters::Subscriber) and these may feed the same synchronizer.
#pragma once

#include <agnocast_rclcpp/agnocast_rclcpp.hpp>

#include <message_filters/simple_filter.h>

#include <memory>
#include <string>
#include <utility>

namespace agnocast::message_filters {

/// Like ::message_filters::Subscriber. Filters run in the subscription's callback.
template <class M>
class Subscriber : public ::message_filters::SimpleFilter<M> {
 public:
  /// A filter keeps messages: up to its queue size of each input, which the hold quota must allow:
  /// 256 unless agnocast::core::SubscriptionOptions say otherwise.
  using Options = agnocast_rclcpp::SubscriptionOptions;

  Subscriber() = default;
  template <class Node>
  Subscriber(Node&& node, const std::string& topic, const rclcpp::QoS& qos = rclcpp::QoS(10),
             const Options& options = {}) {
    subscribe(std::forward<Node>(node), topic, qos, options);
  }
  /// Throws agnocast::Error.
  template <class Node>
  void subscribe(Node&& node, const std::string& topic, const rclcpp::QoS& qos = rclcpp::QoS(10),
                 const Options& options = {}) {
    unsubscribe();
    subscription_ = agnocast::core::create_subscription<M>(
        std::forward<Node>(node), topic, qos,
        [this](std::shared_ptr<const M> message) { this->signalMessage(std::move(message)); },
        with_quota(options));
  }
  /// Waits for a running callback, unless it is called inside one.
  void unsubscribe() { subscription_.reset(); }
  const typename agnocast::core::Subscription<M>::SharedPtr& getSubscriber() const {
    return subscription_;
  }
  /// Called by filters that have this one as their input; there is nothing before it.
  template <class Filter>
  void connectInput(Filter&) {}
  void add(const ::message_filters::MessageEvent<M const>&) {}

 private:
  static Options with_quota(Options options) {
    agnocast_rclcpp::allow_queue(options.own, 256);
    return options;
  }

  typename agnocast::core::Subscription<M>::SharedPtr subscription_;
};

}  // namespace agnocast::message_filters
