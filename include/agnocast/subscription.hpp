// SPDX-License-Identifier: Apache-2.0
//
// Subscription: delivers messages by callback, by take() or take_batch(), or only the newest one
// (PollingSubscriber). A received message is read-only memory of its publisher. It is valid as
// long as it is held, even after the subscription, its node or the publisher's process has ended.
#pragma once

#include <agnocast/callback_group.hpp>
#include <agnocast/core_namespace.hpp>
#include <agnocast/events.hpp>
#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/message_type.hpp>
#include <agnocast/node_adapter.hpp>
#include <agnocast/node_like.hpp>
#include <agnocast/qos.hpp>
#include <agnocast/result.hpp>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace agnocast {

class SubscriptionEndpoint;
class CallbackSource;
class Watch;

AGNOCAST_CORE_BEGIN

/// Options of a subscription, with setters; the event callbacks are in events.hpp, the callback
/// group in callback_group.hpp.
class SubscriptionOptions : public detail::EventOptions<SubscriptionOptions>,
                            public detail::CallbackGroupOption<SubscriptionOptions> {
 public:
  /// Limits the messages held at once per publisher; further ones stay unread. Creation refuses
  /// 0. Default: 64, and for publishers of other users the rest of the daemon's limit, at least 1
  /// (docs/agnocastd.md, Limits). If that rest is smaller than an explicit quota, creation fails
  /// with quota_exceeded while all publishers of the topic belong to other users.
  SubscriptionOptions& hold_quota(std::size_t messages) noexcept {
    is_hold_quota_usual_ = false;
    return hold_quota_ = messages, is_hold_quota_set_ = true, *this;
  }
  /// The same without a refusal: for publishers of other users, the daemon grants as many as it
  /// would of the default.
  SubscriptionOptions& hold_quota_or_less(std::size_t messages) noexcept {
    is_hold_quota_usual_ = false;
    return hold_quota_ = messages, is_hold_quota_set_ = false, *this;
  }
  SubscriptionOptions& liveliness_callback(std::function<void(LivelinessChangedInfo&)> callback) {
    return events_.liveliness_changed = std::move(callback), *this;
  }
  /// Called when messages begin to wait because of the quota.
  SubscriptionOptions& hold_quota_callback(std::function<void(HoldQuotaInfo&)> callback) {
    return events_.hold_quota = std::move(callback), *this;
  }
  std::size_t hold_quota() const noexcept { return hold_quota_; }
  bool is_hold_quota_set() const noexcept { return is_hold_quota_set_; }
  /// Returns whether neither function was called.
  bool is_hold_quota_usual() const noexcept { return is_hold_quota_usual_; }
  /// Counts keep-last depth for each publisher separately, instead of over all together as a DDS
  /// reader does (DDS 1.4, 2.2.3.18): a frequent publisher then displaces no message of another
  /// one, and a late subscription gets the whole history of each. Of all dead publishers
  /// together, at most 64 messages beyond the depth stay unread. For programs that forward or
  /// record messages of others; each publisher keeps as much for it as for a subscription with
  /// one publisher.
  SubscriptionOptions& depth_per_publisher(bool wanted = true) noexcept {
    return depth_per_publisher_ = wanted, *this;
  }
  bool is_depth_per_publisher() const noexcept { return depth_per_publisher_; }
  /// Matches no publisher of this process, as rclcpp's option of the same name does.
  SubscriptionOptions& ignore_local_publications(bool wanted = true) noexcept {
    return ignore_local_publications_ = wanted, *this;
  }
  bool ignores_local_publications() const noexcept { return ignore_local_publications_; }
  bool is_serial() const noexcept { return is_serial_; }

 protected:
  bool is_serial_ = false;  // one callback at a time, also in a reentrant group

 private:
  std::size_t hold_quota_ = 64;
  bool is_hold_quota_set_ = false;
  bool is_hold_quota_usual_ = true;
  bool depth_per_publisher_ = false;
  bool ignore_local_publications_ = false;
};

AGNOCAST_CORE_END

namespace detail {

class AGNOCAST_PUBLIC UntypedSubscription {
 public:
  using Callback = std::function<void(Block*)>;  // takes over one reference to the block
  /// Creates a subscription; without a callback it is for take(). The executor of its callback
  /// group runs callbacks.
  [[nodiscard]] static Result<std::shared_ptr<UntypedSubscription>> create(
      const EndpointName& name, const MessageType& type, const QoS& qos,
      const core::SubscriptionOptions& options, Callback callback);
  ~UntypedSubscription();
  UntypedSubscription(const UntypedSubscription&) = delete;
  UntypedSubscription& operator=(const UntypedSubscription&) = delete;

  /// Ends taking and callbacks; waits for a running callback, unless called from inside one. Call
  /// it once. Waits for the daemon until `end` at most.
  void end(std::chrono::steady_clock::time_point end =
               std::chrono::steady_clock::time_point::max()) noexcept;
  /// Returns false in a forked child, where no lock may be taken: it may be held for ever.
  bool is_own() const noexcept;
  /// Takes the oldest unread messages, at most `count`, chained in order by Block::next; null:
  /// none.
  Block* take(std::size_t count = 1) noexcept;
  bool has_unread() const noexcept;
  Arrivals arrivals() noexcept;
  std::uint64_t lost() const noexcept;
  std::size_t publisher_count() const noexcept;
  /// Returns how many of these this process has mapped.
  std::size_t linked_publisher_count() const noexcept;
  std::uint64_t callback_exception_count() const noexcept;
  MatchedInfo matched_status() noexcept;
  IncompatibleQosInfo incompatible_qos_status() noexcept;
  DeadlineMissedInfo deadline_missed_status() noexcept;
  std::chrono::steady_clock::time_point event_due() const noexcept;
  LivelinessChangedInfo liveliness_changed_status() noexcept;
  IncompatibleTypeInfo incompatible_type_status() noexcept;
  HeapCollisionInfo heap_collision_status() noexcept;
  HoldQuotaInfo hold_quota_status() noexcept;
  const std::string& topic() const noexcept { return topic_; }
  const QoS& qos() const noexcept { return qos_; }
  bool is_active() const noexcept;
  /// Returns the persistent endpoint id (EndpointName::persistent_id); 0: switched off.
  std::uint64_t persistent_id() const noexcept;
  struct Writer {
    std::uint64_t persistent_id;  // 0: not announced yet; there is no notification when it is
    bool is_gone;                 // but some of its messages are unread
  };
  /// Returns the connected publishers, and dead ones with undelivered messages.
  std::vector<Writer> writers() const;
  /// Registers `watch`, which is notified when matched endpoints change.
  void tell(std::shared_ptr<Watch> watch) noexcept;
  /// Makes the callback `publisher_exhausted` run again.
  void look_again() noexcept;

 private:
  UntypedSubscription(std::string topic, const QoS& qos) noexcept
      : topic_(std::move(topic)), qos_(qos) {}
  std::string topic_;
  QoS qos_;
  std::shared_ptr<SubscriptionEndpoint> endpoint_;
  CallbackGroup::SharedPtr group_;  // this and the next only with callbacks
  std::shared_ptr<CallbackSource> source_;
  bool has_ended_ = false;
};

// `NodesInfo`: the message info that callbacks of the node's own library take.
template <class Function, class NodesInfo, class Argument>
struct Takes : std::bool_constant<std::is_invocable_v<Function&, Argument> ||
                                  std::is_invocable_v<Function&, Argument, const MessageInfo&> ||
                                  std::is_invocable_v<Function&, Argument, const NodesInfo&>> {};

/// The accepted callbacks of create_subscription for messages of type T. A form is tried only if
/// none before it fits, because that instantiates a generic lambda.
template <class T, class NodesInfo, class Callback,
          class Function = std::remove_reference_t<Callback>>
inline constexpr bool is_callback =
    std::disjunction_v<Takes<Function, NodesInfo, ipc_shared_ptr<const T>>,
                       Takes<Function, NodesInfo, ipc_shared_ptr<T>>,
                       Takes<Function, NodesInfo, const T&>,
                       Takes<Function, NodesInfo, std::shared_ptr<const T>>>;

/// Wraps a user's callback: passes the first of ipc_shared_ptr<const T>, ipc_shared_ptr<T> (the
/// memory is read-only all the same), const T& and std::shared_ptr<const T> that it accepts.
template <class T, class Adapter, class Callback>
UntypedSubscription::Callback erase(Callback&& callback) {
  using NodesInfo = typename Adapter::Info;
  static_assert(is_callback<T, NodesInfo, Callback>,
                "a subscription's callback takes agnocast::ipc_shared_ptr<const T>, "
                "agnocast::ipc_shared_ptr<T>, const T& or std::shared_ptr<const T>, and after it a "
                "const agnocast::MessageInfo& if it wants one");
  return [function = std::forward<Callback>(callback)](Block* block) mutable {
    using Function = decltype(function);
    const auto call = [&](auto&& message) {
      using Message = decltype(message);
      if constexpr (std::is_invocable_v<Function&, Message>) {
        function(std::forward<Message>(message));
      } else if constexpr (std::is_invocable_v<Function&, Message, const MessageInfo&>) {
        const MessageInfo info = block->info;  // the callback may release the message first
        function(std::forward<Message>(message), info);
      } else {
        const NodesInfo info = Adapter::info(block->info);
        function(std::forward<Message>(message), info);
      }
    };
    if constexpr (Takes<Function, NodesInfo, ipc_shared_ptr<const T>>::value) {
      call(ipc_shared_ptr<const T>(block));
    } else if constexpr (Takes<Function, NodesInfo, ipc_shared_ptr<T>>::value) {
      call(ipc_shared_ptr<T>(block));
    } else {
      ipc_shared_ptr<const T> message(block);
      if constexpr (Takes<Function, NodesInfo, const T&>::value) {
        call(*message);
      } else {
        call(to_shared_ptr(std::move(message)));
      }
    }
  };
}

/// Passes the messages of a chain one by one to give(number, block). Returns their number.
template <class Give>
std::size_t hand_out(Block* chain, Give give) noexcept {
  std::size_t count = 0;
  while (chain != nullptr) {
    Block* const block = std::exchange(chain, chain->next);  // now the receiver owns it
    give(count++, block);
  }
  return count;
}

}  // namespace detail

/// Functions common to all subscriptions. Any thread may call any of them.
class SubscriptionBase {
 public:
  /// Returns whether take() may find a message. It finds none after all if the message has expired
  /// or was given up meanwhile. No system call.
  bool has_unread() const noexcept { return untyped_->has_unread(); }
  /// Returns how many messages can be taken now (`unread`; as with has_unread() some may be gone),
  /// and a `count` of those that have come, which may leave out some that were lost. Once the hold
  /// quota, or a part of the heap that is not mapped yet, keeps messages from being taken, they are
  /// counted again when they can be. So a loop that takes once for each step of `count` misses
  /// nothing, and may find nothing at times. Looks at each connected publisher, some 20 ns each. No
  /// system call.
  Arrivals get_arrivals() noexcept { return untyped_->arrivals(); }
  /// Returns the number of messages dropped because this subscription's depth was exceeded.
  std::uint64_t get_lost_count() const noexcept { return untyped_->lost(); }
  /// Returns the number of matched publishers. One counts as soon as its creation has returned, in
  /// any process; a dead one does not, though its messages are still delivered. Costs a look at
  /// each place of the topic, microseconds at most; allocates nothing.
  std::size_t get_publisher_count() const noexcept { return untyped_->publisher_count(); }
  /// Returns how many of these this process has mapped. For measurements and tests.
  std::size_t get_linked_publisher_count() const noexcept {
    return untyped_->linked_publisher_count();
  }
  /// Returns the number of exceptions thrown by callbacks of this subscription in a
  /// BackgroundExecutor, which cannot pass them on. In others they leave spin() instead and are
  /// not counted.
  std::uint64_t get_callback_exception_count() const noexcept {
    return untyped_->callback_exception_count();
  }
  /// These return changes since the last call (events.hpp).
  MatchedInfo get_matched_status() noexcept { return untyped_->matched_status(); }
  IncompatibleQosInfo get_incompatible_qos_status() noexcept {
    return untyped_->incompatible_qos_status();
  }
  DeadlineMissedInfo get_deadline_missed_status() noexcept {
    return untyped_->deadline_missed_status();
  }
  /// Returns when a period of the deadline or a lease of the liveliness may end next: a loop that
  /// looks at these counts looks again then. time_point::max(): there are none.
  std::chrono::steady_clock::time_point get_event_due() const noexcept {
    return untyped_->event_due();
  }
  LivelinessChangedInfo get_liveliness_changed_status() noexcept {
    return untyped_->liveliness_changed_status();
  }
  IncompatibleTypeInfo get_type_mismatch_status() noexcept {
    return untyped_->incompatible_type_status();
  }
  HeapCollisionInfo get_heap_collision_status() noexcept {
    return untyped_->heap_collision_status();
  }
  HoldQuotaInfo get_hold_quota_status() noexcept { return untyped_->hold_quota_status(); }
  /// Returns false if AGNOCAST=off was in the environment at creation, or the session of the
  /// process was revoked: no message ever arrives.
  bool is_active() const noexcept { return untyped_->is_active(); }
  const char* get_topic_name() const noexcept { return untyped_->topic().c_str(); }
  /// Returns the QoS that the subscription requests; it converts to an rclcpp::QoS.
  QoS get_actual_qos() const noexcept { return untyped_->qos(); }

 protected:
  explicit SubscriptionBase(std::shared_ptr<detail::UntypedSubscription> untyped) noexcept
      : untyped_(std::move(untyped)) {}
  ~SubscriptionBase() = default;
  detail::UntypedSubscription& untyped() const noexcept { return *untyped_; }

 private:
  std::shared_ptr<detail::UntypedSubscription> untyped_;
};

AGNOCAST_CORE_BEGIN

/// Any thread may call any function.
template <class T>
class Subscription : public SubscriptionBase {
 public:
  using SharedPtr = std::shared_ptr<Subscription>;
  explicit Subscription(std::shared_ptr<detail::UntypedSubscription> untyped) noexcept
      : SubscriptionBase(std::move(untyped)) {}

  /// Takes the oldest unread message, or returns an empty pointer. No system call, except after a
  /// publisher's heap has grown. Not for a subscription with a callback.
  ipc_shared_ptr<const T> take() noexcept { return ipc_shared_ptr<const T>(untyped().take()); }

  /// Takes the oldest unread messages, at most `count`, into messages[0], messages[1] …; returns
  /// their number. They are the messages that as many calls of take() would return, in the same
  /// order: per publisher as published, between publishers by the time of publishing. Messages
  /// published during the call may be left to the next one.
  ///
  /// First resets all `count` elements of the array, so it can be used again and again; elements
  /// after the last message stay empty. Each message is held individually, as with take(), with
  /// its MessageInfo, and counts against the hold quota: messages beyond it (64 per publisher by
  /// default) stay unread. 0 is no error: there is no message, as with take().
  ///
  /// It locks the subscription and examines its publishers once for all messages, so a message
  /// costs about half of a take(). Memory and system calls as there. Other threads' calls of this
  /// subscription wait meanwhile; `count` bounds that time. Not for a subscription with a
  /// callback.
  std::size_t take_batch(ipc_shared_ptr<const T>* messages, std::size_t count) noexcept {
    for (std::size_t i = 0; i < count; ++i) messages[i].reset();
    return detail::hand_out(untyped().take(count), [&](std::size_t i, detail::Block* block) {
      messages[i] = ipc_shared_ptr<const T>(block);
    });
  }
};

/// A subscription without a callback. Besides take() it has the function of Autoware's polling
/// subscribers: take_data() returns the newest message.
template <class T>
class PollingSubscriber : public Subscription<T> {
 public:
  using SharedPtr = std::shared_ptr<PollingSubscriber>;
  using Subscription<T>::Subscription;

  /// Returns the newest message: the same again while there is no newer one, empty before the
  /// first. Skips messages in between (they do not count as lost). The subscription keeps holding
  /// the message. Empty in a forked child.
  ipc_shared_ptr<const T> take_data() noexcept {
    if (!this->untyped().is_own()) return {};
    const std::lock_guard lock(mutex_);
    while (auto newer = this->take()) newest_ = std::move(newer);
    return newest_;
  }
  /// The older spelling.
  ipc_shared_ptr<const T> takeData() noexcept { return take_data(); }

 private:
  std::mutex mutex_;
  ipc_shared_ptr<const T> newest_;
};

AGNOCAST_CORE_END

namespace detail {

template <class Made, class T, class Node>
Result<std::shared_ptr<Made>> make_subscription(Node& node, const std::string& topic,
                                                const QoS& qos,
                                                UntypedSubscription::Callback callback,
                                                const SubscriptionOptionsOf<Node>& options) {
  Result<EndpointName> name = resolve(dereference(node), topic);
  if (!name) return tl::unexpected<Failure>(name.error());
  const Result<MessageType> type = message_type_of<T>();
  if (!type) return tl::unexpected<Failure>(type.error());
  QoS used = qos;
  const Result<core::SubscriptionOptions> adapted =
      AdapterOf<Node>::options(dereference(node), *name, used, options);
  if (!adapted) return tl::unexpected<Failure>(adapted.error());
  auto untyped = UntypedSubscription::create(*name, *type, used, *adapted, std::move(callback));
  if (!untyped) return tl::unexpected<Failure>(untyped.error());
  return std::make_shared<Made>(std::move(*untyped));
}

}  // namespace detail

AGNOCAST_CORE_BEGIN

/// Creates a subscription that calls `callback` for each message, in the executor of its callback
/// group. `callback` takes ipc_shared_ptr<const T> (or of T), by value, const reference or rvalue,
/// or const T&, or std::shared_ptr<const T>, and optionally a const MessageInfo&.
template <class T, class Node, class Callback,
          class = std::enable_if_t<
              !std::is_convertible_v<Callback, const detail::SubscriptionOptionsOf<Node>&>>>
[[nodiscard]] Result<typename Subscription<T>::SharedPtr> try_create_subscription(
    Node&& node, const std::string& topic, const QoS& qos, Callback&& callback,
    const detail::SubscriptionOptionsOf<Node>& options = {}) {
  return detail::make_subscription<Subscription<T>, T>(
      node, topic, qos, detail::erase<T, detail::AdapterOf<Node>>(std::forward<Callback>(callback)),
      options);
}
/// The same without a callback: for take().
template <class T, class Node>
[[nodiscard]] Result<typename PollingSubscriber<T>::SharedPtr> try_create_subscription(
    Node&& node, const std::string& topic, const QoS& qos,
    const detail::SubscriptionOptionsOf<Node>& options = {}) {
  return detail::make_subscription<PollingSubscriber<T>, T>(node, topic, qos, nullptr, options);
}

/// The same; these throw agnocast::Error.
template <class T, class Node, class Callback,
          class = std::enable_if_t<
              !std::is_convertible_v<Callback, const detail::SubscriptionOptionsOf<Node>&>>>
typename Subscription<T>::SharedPtr create_subscription(
    Node&& node, const std::string& topic, const QoS& qos, Callback&& callback,
    const detail::SubscriptionOptionsOf<Node>& options = {}) {
  auto subscription =
      try_create_subscription<T>(node, topic, qos, std::forward<Callback>(callback), options);
  if (!subscription) detail::throw_error(subscription.error());
  return std::move(*subscription);
}
template <class T, class Node>
typename PollingSubscriber<T>::SharedPtr create_subscription(
    Node&& node, const std::string& topic, const QoS& qos,
    const detail::SubscriptionOptionsOf<Node>& options = {}) {
  auto subscription = try_create_subscription<T>(node, topic, qos, options);
  if (!subscription) detail::throw_error(subscription.error());
  return std::move(*subscription);
}

AGNOCAST_CORE_END

}  // namespace agnocast
