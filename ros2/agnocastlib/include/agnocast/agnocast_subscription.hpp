// SPDX-License-Identifier: Apache-2.0
//
// Subscriptions with a callback, for take(), and for the newest message.
#pragma once

#include <agnocastlib/endpoints.hpp>

#include <rclcpp/rclcpp.hpp>

#include <memory>
#include <mutex>
#include <string>
#include <utility>

namespace agnocast {

/// A subscription with a callback, which runs where rclcpp runs those of the callback group.
template <class MessageT>
class Subscription : public core::Subscription<MessageT> {
  using Base = core::Subscription<MessageT>;

 public:
  using SharedPtr = std::shared_ptr<Subscription>;

  /// `callback` takes ipc_shared_ptr<const MessageT> or ipc_shared_ptr<MessageT>, by value, const
  /// reference or rvalue; the memory is read-only in both cases. Throws Error.
  template <class NodeT, class Func>
  Subscription(NodeT* node, const std::string& topic_name, const rclcpp::QoS& qos, Func&& callback,
               const SubscriptionOptions& options = {})
      : Base(make(node, topic_name, qos, std::forward<Func>(callback), options)) {}

 private:
  template <class NodeT, class Func>
  static Base make(NodeT* node, const std::string& topic, const rclcpp::QoS& qos, Func&& callback,
                   const SubscriptionOptions& options) {
    agnocastlib::refuse_other_system();
    agnocastlib::keep_group(node->get_node_base_interface(), options.callback_group);
    return *core::create_subscription<MessageT>(*node, topic, qos, std::forward<Func>(callback),
                                                agnocastlib::translate(options));
  }
};

/// A subscription without a callback. Needs no executor. Any thread may call any function.
template <class MessageT>
class TakeSubscription : public core::Subscription<MessageT> {
  using Base = core::Subscription<MessageT>;

 public:
  using SharedPtr = std::shared_ptr<TakeSubscription>;

  /// Throws Error.
  template <class NodeT>
  TakeSubscription(NodeT* node, const std::string& topic_name, const rclcpp::QoS& qos,
                   const SubscriptionOptions& options = {})
      : Base(make(node, topic_name, qos, options)) {}

  /// False: returns the oldest unread message, empty if there is none. True: returns the newest
  /// message, also if it was taken before, and skips those in between. The subscription holds the
  /// message that it returned last.
  ipc_shared_ptr<const MessageT> take(bool allow_same_message = false) noexcept {
    if (!this->untyped().is_own()) return {};  // in a forked child the lock may be held for ever
    agnocastlib::report_if_daemon_is_lost();
    const std::lock_guard lock(mutex_);
    if (!allow_same_message) {
      auto message = Base::take();
      if (message) last_ = message;
      return message;
    }
    while (auto newer = Base::take()) last_ = std::move(newer);
    return last_;
  }

 private:
  template <class NodeT>
  static Base make(NodeT* node, const std::string& topic, const rclcpp::QoS& qos,
                   const SubscriptionOptions& options) {
    agnocastlib::refuse_other_system();
    agnocastlib::keep_group(node->get_node_base_interface(), options.callback_group);
    return *core::create_subscription<MessageT>(*node, topic, qos, agnocastlib::translate(options));
  }

  std::mutex mutex_;
  ipc_shared_ptr<const MessageT> last_;
};

/// Gives the newest message. Any thread may call any function.
template <class MessageT>
class PollingSubscriber {
 public:
  using SharedPtr = std::shared_ptr<PollingSubscriber>;

  /// Throws Error.
  template <class NodeT>
  explicit PollingSubscriber(NodeT* node, const std::string& topic_name,
                             const rclcpp::QoS& qos = rclcpp::QoS{1},
                             const SubscriptionOptions& options = {})
      : subscription_(node, topic_name, qos, options) {}

  /// Returns the newest message, the same again while there is no newer one, empty before the
  /// first.
  ipc_shared_ptr<const MessageT> take_data() noexcept { return subscription_.take(true); }
  ipc_shared_ptr<const MessageT> takeData() noexcept { return take_data(); }

 private:
  TakeSubscription<MessageT> subscription_;
};

}  // namespace agnocast
