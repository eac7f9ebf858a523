// SPDX-License-Identifier: Apache-2.0
//
// A source for the filters and synchronizers of the package message_filters, which must be linked.
// Its messages are the publisher's memory, held as long as a filter keeps them. Sources of rclcpp's
// (::message_filters::Subscriber) and these may feed the same synchronizer.
#pragma once

#include <agnocast_rclcpp/agnocast_rclcpp.hpp>

#include <message_filters/simple_filter.h>

#include <functional>
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
  Subscriber(Node&& node, const std::string& topic, const agnocast::QoS& qos = 10,
             const Options& options = {}) {
    subscribe(std::forward<Node>(node), topic, qos, options);
  }
  Subscriber(const Subscriber&) = delete;
  Subscriber& operator=(const Subscriber&) = delete;

  /// In place of an earlier subscription. Throws agnocast::Error.
  template <class Node>
  void subscribe(Node&& node, const std::string& topic, const agnocast::QoS& qos = 10,
                 const Options& options = {}) {
    topic_ = topic;
    subscribe_ = [this, place = &agnocast::detail::dereference(node), qos,
                  with_quota = with_quota(options)] {
      subscription_ = agnocast::core::create_subscription<M>(
          place, topic_, qos,
          [this](std::shared_ptr<const M> message) { this->signalMessage(std::move(message)); },
          with_quota);
    };
    subscribe();
  }
  /// The same again, if there was a first time; the node must still exist.
  void subscribe() {
    unsubscribe();
    if (subscribe_) subscribe_();
  }
  /// Waits for a running callback, unless it is called inside one.
  void unsubscribe() { subscription_.reset(); }
  const typename agnocast::core::Subscription<M>::SharedPtr& getSubscriber() const {
    return subscription_;
  }
  /// As given; "" before the first time.
  std::string getTopic() const { return topic_; }
  /// Called by filters that have this one as their input; there is nothing before it.
  template <class Filter>
  void connectInput(Filter&) {}
  void add(const ::message_filters::MessageEvent<M const>&) {}

 private:
  static Options with_quota(Options options) {
    agnocast_rclcpp::allow_queue(options.own, 256);
    return options;
  }

  std::string topic_;
  std::function<void()> subscribe_;
  typename agnocast::core::Subscription<M>::SharedPtr subscription_;
};

}  // namespace agnocast::message_filters
