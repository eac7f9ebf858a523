// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/message_filters/simple_filter.hpp>
#include <agnocastlib/agnocast.hpp>

#include <rclcpp/rclcpp.hpp>

#include <memory>
#include <string>
#include <utility>

namespace agnocast::message_filters {

/// A subscription without its message type.
template <class NodeType = rclcpp::Node>
class SubscriberBase {
 public:
  using NodePtr = std::shared_ptr<NodeType>;

  virtual ~SubscriberBase() = default;
  /// Ends the present subscription, and begins another one unless `topic` is empty. Throw Error.
  virtual void subscribe(NodePtr node, const std::string& topic,
                         const rmw_qos_profile_t qos = rmw_qos_profile_default) = 0;
  virtual void subscribe(NodeType* node, const std::string& topic,
                         const rmw_qos_profile_t qos = rmw_qos_profile_default) = 0;
  virtual void subscribe(NodePtr node, const std::string& topic, const rmw_qos_profile_t qos,
                         SubscriptionOptions options) = 0;
  virtual void subscribe(NodeType* node, const std::string& topic, const rmw_qos_profile_t qos,
                         SubscriptionOptions options) = 0;
  /// Subscribes as the last time; without effect before the first.
  virtual void subscribe() = 0;
  virtual void unsubscribe() = 0;
};

template <class T>
using SubscriberBasePtr = std::shared_ptr<SubscriberBase<T>>;

/// The source of a chain of filters, which run in the subscription's callback. A filter keeps
/// messages, which then count as held by the subscription: up to 256 of each publisher, unless
/// SubscriptionOptions::hold_quota says otherwise.
template <class M, class NodeType = rclcpp::Node>
class Subscriber : public SubscriberBase<NodeType>, public SimpleFilter<M> {
 public:
  using NodePtr = std::shared_ptr<NodeType>;
  using typename SimpleFilter<M>::MConstPtr;
  using typename SimpleFilter<M>::EventType;

  Subscriber() = default;
  Subscriber(NodePtr node, const std::string& topic,
             const rmw_qos_profile_t qos = rmw_qos_profile_default) {
    begin(node.get(), node, topic, qos, {});
  }
  Subscriber(NodeType* node, const std::string& topic,
             const rmw_qos_profile_t qos = rmw_qos_profile_default) {
    begin(node, nullptr, topic, qos, {});
  }
  Subscriber(NodePtr node, const std::string& topic, const rmw_qos_profile_t qos,
             SubscriptionOptions options) {
    begin(node.get(), node, topic, qos, std::move(options));
  }
  Subscriber(NodeType* node, const std::string& topic, const rmw_qos_profile_t qos,
             SubscriptionOptions options) {
    begin(node, nullptr, topic, qos, std::move(options));
  }
  ~Subscriber() override { subscription_.reset(); }

  void subscribe(NodePtr node, const std::string& topic,
                 const rmw_qos_profile_t qos = rmw_qos_profile_default) override {
    begin(node.get(), node, topic, qos, {});
  }
  void subscribe(NodeType* node, const std::string& topic,
                 const rmw_qos_profile_t qos = rmw_qos_profile_default) override {
    begin(node, nullptr, topic, qos, {});
  }
  void subscribe(NodePtr node, const std::string& topic, const rmw_qos_profile_t qos,
                 SubscriptionOptions options) override {
    begin(node.get(), node, topic, qos, std::move(options));
  }
  void subscribe(NodeType* node, const std::string& topic, const rmw_qos_profile_t qos,
                 SubscriptionOptions options) override {
    begin(node, nullptr, topic, qos, std::move(options));
  }
  void subscribe() override {
    if (!topic_.empty()) begin(node_, kept_node_, topic_, qos_, options_);
  }
  /// Waits for a running callback, unless it is called inside one.
  void unsubscribe() override { subscription_.reset(); }

  std::string getTopic() const { return topic_; }
  const typename Subscription<M>::SharedPtr getSubscriber() const { return subscription_; }
  /// Called by filters that have this one as their input; there is nothing before it.
  template <class F>
  void connectInput(F&) {}
  void add(const EventType&) {}

 private:
  void begin(NodeType* node, NodePtr kept, std::string topic, const rmw_qos_profile_t qos,
             SubscriptionOptions options) {
    subscription_.reset();
    if (topic.empty()) return;
    node_ = node;
    kept_node_ = std::move(kept);
    topic_ = std::move(topic);
    qos_ = qos;
    options_ = std::move(options);
    if (options_.hold_quota == 0) options_.hold_quota = 256;
    const rclcpp::QoS wanted(rclcpp::QoSInitialization::from_rmw(qos_), qos_);
    subscription_ = std::make_shared<Subscription<M>>(
        node_, topic_, wanted,
        [this](MConstPtr message) { this->signalMessage(EventType(std::move(message))); },
        options_);
  }

  NodeType* node_ = nullptr;
  NodePtr kept_node_;  // null: the user gave a pointer
  std::string topic_;
  rmw_qos_profile_t qos_ = rmw_qos_profile_default;
  SubscriptionOptions options_;
  typename Subscription<M>::SharedPtr subscription_;  // ends first
};

}  // namespace agnocast::message_filters
