// SPDX-License-Identifier: Apache-2.0
//
// Subscription: messages by callback or by take(). A received message is read-only memory of its
// publisher, valid as long as it is held: also after the subscription, its node or the publisher's
// process are gone.
#pragma once

#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/message_type.hpp>
#include <agnocast/node_like.hpp>
#include <agnocast/qos.hpp>
#include <agnocast/result.hpp>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>

namespace agnocast {

class Runner;
class SubscriptionEndpoint;

/// Options of a subscription, with setters.
class SubscriptionOptions {
 public:
  /// Messages held at once per publisher, at most; what is beyond stays unread (default 64).
  SubscriptionOptions& hold_quota(std::size_t messages) noexcept {
    return hold_quota_ = messages, *this;
  }
  std::size_t hold_quota() const noexcept { return hold_quota_; }

 private:
  std::size_t hold_quota_ = 64;
};

namespace detail {

class AGNOCAST_PUBLIC UntypedSubscription {
 public:
  using Callback = std::function<void(Block*)>;  // takes over one use of the block
  /// Without a callback: for take(). With one: run by the runner of `node_key` (a library thread
  /// unless an executor has it).
  [[nodiscard]] static Result<std::shared_ptr<UntypedSubscription>> create(
      const EndpointName& name, const MessageType& type, const QoS& qos,
      const SubscriptionOptions& options, Callback callback);
  ~UntypedSubscription();
  UntypedSubscription(const UntypedSubscription&) = delete;
  UntypedSubscription& operator=(const UntypedSubscription&) = delete;

  /// The oldest unread message, or null.
  Block* take() noexcept;
  std::uint64_t lost() const noexcept;
  std::size_t publisher_count() const noexcept;
  const std::string& topic() const noexcept { return topic_; }

 private:
  UntypedSubscription() noexcept = default;
  std::string topic_;
  std::shared_ptr<SubscriptionEndpoint> endpoint_;
  std::shared_ptr<Runner> runner_;
};

/// How a user's callback is called: with ipc_shared_ptr<const T> if it takes that, else with
/// ipc_shared_ptr<T> (rclcpp users' habit; the memory is read-only all the same).
template <class T, class Callback>
UntypedSubscription::Callback erase(Callback&& callback) {
  static_assert(std::is_invocable_v<Callback&, ipc_shared_ptr<const T>> ||
                    std::is_invocable_v<Callback&, ipc_shared_ptr<T>>,
                "a subscription's callback takes agnocast::ipc_shared_ptr<const T> or "
                "agnocast::ipc_shared_ptr<T>");
  return [call = std::forward<Callback>(callback)](Block* block) mutable {
    if constexpr (std::is_invocable_v<Callback&, ipc_shared_ptr<const T>>) {
      call(ipc_shared_ptr<const T>(block));
    } else {
      call(ipc_shared_ptr<T>(block));
    }
  };
}

}  // namespace detail

/// Any thread may call anything.
template <class T>
class Subscription {
 public:
  using SharedPtr = std::shared_ptr<Subscription>;
  explicit Subscription(std::shared_ptr<detail::UntypedSubscription> untyped) noexcept
      : untyped_(std::move(untyped)) {}

  /// The oldest unread message, or an empty pointer. No system call, except after a publisher's
  /// heap has grown. Not for one with a callback.
  ipc_shared_ptr<const T> take() noexcept { return ipc_shared_ptr<const T>(untyped_->take()); }
  /// Messages that were dropped because this subscription's depth was exceeded.
  std::uint64_t get_lost_count() const noexcept { return untyped_->lost(); }
  std::size_t get_publisher_count() const noexcept { return untyped_->publisher_count(); }
  const char* get_topic_name() const noexcept { return untyped_->topic().c_str(); }

 private:
  std::shared_ptr<detail::UntypedSubscription> untyped_;
};

/// A subscription, or why there is none. With a callback it is called for each message by the
/// node's executor, or by a library thread of the node.
template <class T, class Node>
[[nodiscard]] Result<typename Subscription<T>::SharedPtr> try_create_subscription(
    Node&& node, const std::string& topic, const QoS& qos,
    detail::UntypedSubscription::Callback callback = nullptr,
    const SubscriptionOptions& options = {}) {
  Result<detail::EndpointName> name = detail::resolve(detail::dereference(node), topic);
  if (!name) return tl::unexpected<Failure>(name.error());
  const Result<MessageType> type = message_type_of<T>();
  if (!type) return tl::unexpected<Failure>(type.error());
  auto untyped =
      detail::UntypedSubscription::create(*name, *type, qos, options, std::move(callback));
  if (!untyped) return tl::unexpected<Failure>(untyped.error());
  return std::make_shared<Subscription<T>>(std::move(*untyped));
}

/// The same; throws agnocast::Error.
template <class T, class Node, class Callback>
typename Subscription<T>::SharedPtr create_subscription(Node&& node, const std::string& topic,
                                                        const QoS& qos, Callback&& callback,
                                                        const SubscriptionOptions& options = {}) {
  auto subscription = try_create_subscription<T>(
      node, topic, qos, detail::erase<T>(std::forward<Callback>(callback)), options);
  if (!subscription) throw Error(subscription.error());
  return std::move(*subscription);
}
/// Without a callback: for take().
template <class T, class Node>
typename Subscription<T>::SharedPtr create_subscription(Node&& node, const std::string& topic,
                                                        const QoS& qos) {
  auto subscription = try_create_subscription<T>(node, topic, qos);
  if (!subscription) throw Error(subscription.error());
  return std::move(*subscription);
}

}  // namespace agnocast
