// SPDX-License-Identifier: Apache-2.0
//
// Subscription: messages by callback, by take() or take_batch(), or only ever the newest
// (PollingSubscriber). A received message is read-only memory of its publisher, valid as long as it is
// held: also after the subscription, its node or the publisher's process are gone.
#pragma once

#include <agnocast/events.hpp>
#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/message_type.hpp>
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

class Runner;
class SubscriptionEndpoint;
class CallbackSource;
class Watch;

/// Options of a subscription, with setters; those of the event callbacks are in events.hpp.
class SubscriptionOptions : public detail::EventOptions<SubscriptionOptions> {
 public:
  /// Messages held at once per publisher, at most; what is beyond stays unread. 0 is refused at
  /// creation. Without a call: 64, and of publishers of other users what the daemon has left, 1 at
  /// least (docs/agnocastd.md, Limits). A number that is set and not to be had there is refused with
  /// quota_exceeded while every publisher of the topic is another user's.
  SubscriptionOptions& hold_quota(std::size_t messages) noexcept {
    return hold_quota_ = messages, is_hold_quota_set_ = true, *this;
  }
  std::size_t hold_quota() const noexcept { return hold_quota_; }
  bool is_hold_quota_set() const noexcept { return is_hold_quota_set_; }
  /// Keep-last counts for each publisher by itself, and no longer over all of them together as in a
  /// DDS reader (DDS 1.4, 2.2.3.18): a publisher that publishes much pushes out nothing of another
  /// one, and a late subscription gets the whole history of each. Of publishers that are gone, all
  /// together, 64 messages beyond the depth stay unread at most. For whoever passes on or records
  /// what others publish; each publisher keeps as much for it as with one alone.
  SubscriptionOptions& depth_per_publisher(bool wanted = true) noexcept {
    return depth_per_publisher_ = wanted, *this;
  }
  bool is_depth_per_publisher() const noexcept { return depth_per_publisher_; }

 private:
  std::size_t hold_quota_ = 64;
  bool is_hold_quota_set_ = false;
  bool depth_per_publisher_ = false;
};

namespace detail {

class AGNOCAST_PUBLIC UntypedSubscription {
 public:
  using Callback = std::function<void(Block*)>;  // takes over one use of the block
  /// Without a callback: for take(). Callbacks are run by the node's executor, or by a library
  /// thread of the node.
  [[nodiscard]] static Result<std::shared_ptr<UntypedSubscription>> create(
      const EndpointName& name, const MessageType& type, const QoS& qos,
      const SubscriptionOptions& options, Callback callback);
  ~UntypedSubscription();
  UntypedSubscription(const UntypedSubscription&) = delete;
  UntypedSubscription& operator=(const UntypedSubscription&) = delete;

  /// No callback runs afterwards, unless this is called from inside one, and nothing is taken any
  /// more. Once. Waits no longer for the daemon than until `end`.
  void end(std::chrono::steady_clock::time_point end =
               std::chrono::steady_clock::time_point::max()) noexcept;
  /// False in a forked child: then no lock may be taken, it may be held for ever.
  bool is_own() const noexcept;
  /// The oldest unread messages, at most `count`, chained in order by Block::next; null: none.
  Block* take(std::size_t count = 1) noexcept;
  std::uint64_t lost() const noexcept;
  std::size_t publisher_count() const noexcept;
  std::uint64_t callback_exception_count() const noexcept;
  MatchedInfo matched_status() noexcept;
  IncompatibleQosInfo incompatible_qos_status() noexcept;
  IncompatibleTypeInfo incompatible_type_status() noexcept;
  HeapCollisionInfo heap_collision_status() noexcept;
  const std::string& topic() const noexcept { return topic_; }
  bool is_active() const noexcept;
  /// See EndpointName::lineage; 0: switched off.
  std::uint64_t lineage() const noexcept;
  struct Writer {
    std::uint64_t lineage;  // 0: not said yet; nothing tells when it is
    bool is_gone;           // but something of it is unread
  };
  /// Publishers that are there, and those that something can still come of.
  std::vector<Writer> writers() const;
  /// `watch` is told when what is matched has changed.
  void tell(std::shared_ptr<Watch> watch) noexcept;
  /// Its callback of what is drained is called again.
  void look_again() noexcept;

 private:
  UntypedSubscription() noexcept = default;
  std::string topic_;
  std::shared_ptr<SubscriptionEndpoint> endpoint_;
  std::shared_ptr<Runner> runner_;  // this and the next only with callbacks
  std::shared_ptr<CallbackSource> source_;
  bool has_ended_ = false;
};

template <class Callback, class T>
inline constexpr bool takes_message =
    std::is_invocable_v<Callback&, ipc_shared_ptr<T>> ||
    std::is_invocable_v<Callback&, ipc_shared_ptr<T>, const MessageInfo&>;

/// What create_subscription takes as a callback for messages of type T.
template <class T, class Callback>
inline constexpr bool is_callback = takes_message<std::remove_reference_t<Callback>, const T> ||
                                    takes_message<std::remove_reference_t<Callback>, T>;

template <class Message, class Callback>
void call(Callback& callback, Block* block) {
  if constexpr (std::is_invocable_v<Callback&, ipc_shared_ptr<Message>>) {
    callback(ipc_shared_ptr<Message>(block));
  } else {
    const MessageInfo info = block->info;  // the callback may let the message go first
    callback(ipc_shared_ptr<Message>(block), info);
  }
}

/// How a user's callback is called: with ipc_shared_ptr<const T> if it takes that, else with
/// ipc_shared_ptr<T> (rclcpp users' habit; the memory is read-only all the same).
template <class T, class Callback>
UntypedSubscription::Callback erase(Callback&& callback) {
  static_assert(is_callback<T, Callback>,
                "a subscription's callback takes agnocast::ipc_shared_ptr<const T> or "
                "agnocast::ipc_shared_ptr<T>, and after it a const agnocast::MessageInfo& if it "
                "wants one");
  return [function = std::forward<Callback>(callback)](Block* block) mutable {
    using Function = decltype(function);
    using Message = std::conditional_t<takes_message<Function, const T>, const T, T>;
    call<Message>(function, block);
  };
}

/// Gives the messages of a chain away one by one, as give(number, block). How many.
template <class Give>
std::size_t hand_out(Block* chain, Give give) noexcept {
  std::size_t count = 0;
  while (chain != nullptr) {
    Block* const block = std::exchange(chain, chain->next);  // afterwards it is another's
    give(count++, block);
  }
  return count;
}

}  // namespace detail

/// What all subscriptions can say. Any thread may call anything.
class SubscriptionBase {
 public:
  /// Messages that were dropped because this subscription's depth was exceeded.
  std::uint64_t get_lost_count() const noexcept { return untyped_->lost(); }
  /// Matched publishers that this process has mapped; a moment ago. Not those that are gone, though
  /// what they have published is still delivered.
  std::size_t get_publisher_count() const noexcept { return untyped_->publisher_count(); }
  /// Exceptions that left a callback of this subscription in the library's thread. There is nobody
  /// to give them to; in an executor they leave spin() instead and are not counted.
  std::uint64_t get_callback_exception_count() const noexcept {
    return untyped_->callback_exception_count();
  }
  /// Changes are counted since the last call (events.hpp).
  MatchedInfo get_matched_status() noexcept { return untyped_->matched_status(); }
  IncompatibleQosInfo get_incompatible_qos_status() noexcept {
    return untyped_->incompatible_qos_status();
  }
  IncompatibleTypeInfo get_type_mismatch_status() noexcept {
    return untyped_->incompatible_type_status();
  }
  HeapCollisionInfo get_heap_collision_status() noexcept {
    return untyped_->heap_collision_status();
  }
  /// False when AGNOCAST=off was in the environment as this was created, and when the membership of the
  /// process was revoked: nothing ever arrives.
  bool is_active() const noexcept { return untyped_->is_active(); }
  const char* get_topic_name() const noexcept { return untyped_->topic().c_str(); }

 protected:
  explicit SubscriptionBase(std::shared_ptr<detail::UntypedSubscription> untyped) noexcept
      : untyped_(std::move(untyped)) {}
  ~SubscriptionBase() = default;
  detail::UntypedSubscription& untyped() const noexcept { return *untyped_; }

 private:
  std::shared_ptr<detail::UntypedSubscription> untyped_;
};

/// Any thread may call anything.
template <class T>
class Subscription : public SubscriptionBase {
 public:
  using SharedPtr = std::shared_ptr<Subscription>;
  explicit Subscription(std::shared_ptr<detail::UntypedSubscription> untyped) noexcept
      : SubscriptionBase(std::move(untyped)) {}

  /// The oldest unread message, or an empty pointer. No system call, except after a publisher's
  /// heap has grown. Not for one with a callback.
  ipc_shared_ptr<const T> take() noexcept { return ipc_shared_ptr<const T>(untyped().take()); }

  /// The oldest unread messages, at most `count` of them, into messages[0], messages[1] …; how many.
  /// They are those that as many calls of take() would have given, in the same order: of each
  /// publisher as it published them, between publishers by the time of publishing. What is published
  /// during the call may be left to the next one.
  ///
  /// What the array holds before, all `count` of it, is let go of first, so the same array can be used
  /// again and again; behind the last message it is empty. Each message is held by itself, like one of
  /// take(), with its MessageInfo and as one of the hold quota: what is beyond that (64 of a publisher
  /// by default) stays unread. 0 is no error: there is nothing, as with take().
  ///
  /// The subscription is locked and its publishers are looked at once for all of them, so a message
  /// costs about half of a take(). Memory and system calls as there. Other calls of this subscription
  /// in other threads wait meanwhile: `count` bounds that. Not for one with a callback.
  std::size_t take_batch(ipc_shared_ptr<const T>* messages, std::size_t count) noexcept {
    for (std::size_t i = 0; i < count; ++i) messages[i].reset();
    return detail::hand_out(untyped().take(count), [&](std::size_t i, detail::Block* block) {
      messages[i] = ipc_shared_ptr<const T>(block);
    });
  }
};

/// A subscription without a callback. Beside take() it has the habit of Autoware's polling
/// subscribers: take_data() is whatever is newest now.
template <class T>
class PollingSubscriber : public Subscription<T> {
 public:
  using SharedPtr = std::shared_ptr<PollingSubscriber>;
  using Subscription<T>::Subscription;

  /// The newest message, the same again while there is no newer one, empty before the first. What
  /// came in between is skipped (it is not counted as lost). The subscription keeps holding it.
  /// Empty in a forked child.
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

namespace detail {

template <class Made, class T, class Node>
Result<std::shared_ptr<Made>> make_subscription(Node& node, const std::string& topic,
                                                const QoS& qos,
                                                UntypedSubscription::Callback callback,
                                                const SubscriptionOptions& options) {
  Result<EndpointName> name = resolve(dereference(node), topic);
  if (!name) return tl::unexpected<Failure>(name.error());
  const Result<MessageType> type = message_type_of<T>();
  if (!type) return tl::unexpected<Failure>(type.error());
  auto untyped = UntypedSubscription::create(*name, *type, qos, options, std::move(callback));
  if (!untyped) return tl::unexpected<Failure>(untyped.error());
  return std::make_shared<Made>(std::move(*untyped));
}

}  // namespace detail

/// A subscription whose callback is called for each message, by the node's executor or by a library
/// thread of the node; or why there is none. `callback` takes ipc_shared_ptr<const T> (or of T), by
/// value, const reference or rvalue, and then a const MessageInfo& if it wants one.
template <class T, class Node, class Callback,
          class = std::enable_if_t<!std::is_same_v<std::decay_t<Callback>, SubscriptionOptions>>>
[[nodiscard]] Result<typename Subscription<T>::SharedPtr> try_create_subscription(
    Node&& node, const std::string& topic, const QoS& qos, Callback&& callback,
    const SubscriptionOptions& options = {}) {
  return detail::make_subscription<Subscription<T>, T>(
      node, topic, qos, detail::erase<T>(std::forward<Callback>(callback)), options);
}
/// Without a callback: for take().
template <class T, class Node>
[[nodiscard]] Result<typename PollingSubscriber<T>::SharedPtr> try_create_subscription(
    Node&& node, const std::string& topic, const QoS& qos,
    const SubscriptionOptions& options = {}) {
  return detail::make_subscription<PollingSubscriber<T>, T>(node, topic, qos, nullptr, options);
}

/// The same; these throw agnocast::Error.
template <class T, class Node, class Callback,
          class = std::enable_if_t<!std::is_same_v<std::decay_t<Callback>, SubscriptionOptions>>>
typename Subscription<T>::SharedPtr create_subscription(Node&& node, const std::string& topic,
                                                        const QoS& qos, Callback&& callback,
                                                        const SubscriptionOptions& options = {}) {
  auto subscription =
      try_create_subscription<T>(node, topic, qos, std::forward<Callback>(callback), options);
  if (!subscription) detail::throw_error(subscription.error());
  return std::move(*subscription);
}
template <class T, class Node>
typename PollingSubscriber<T>::SharedPtr create_subscription(
    Node&& node, const std::string& topic, const QoS& qos,
    const SubscriptionOptions& options = {}) {
  auto subscription = try_create_subscription<T>(node, topic, qos, options);
  if (!subscription) detail::throw_error(subscription.error());
  return std::move(*subscription);
}

}  // namespace agnocast
