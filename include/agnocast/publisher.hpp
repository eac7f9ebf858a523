// SPDX-License-Identifier: Apache-2.0
//
// Publisher: borrow a message, fill it with whatever its type can do, publish it. Nothing is copied
// and nothing serialized; what was built outside the shared heap is adopted (copied once, and said
// so).
#pragma once

#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/message_type.hpp>
#include <agnocast/node_like.hpp>
#include <agnocast/qos.hpp>
#include <agnocast/residency.hpp>
#include <agnocast/result.hpp>

#include <cstdint>
#include <memory>
#include <string>
#include <utility>

namespace agnocast {

class PublisherEndpoint;

/// What publish did. Converts to true when the message was committed; then it is the queue's.
/// Otherwise the caller still has it.
struct PublishResult {
  Errc code =
      Errc::ok;  ///< ok, no_slot, would_block, heap_exhausted, loan_invalid, user_code_threw
  std::uint64_t adopted_bytes =
      0;  ///< bytes outside the shared heap that had to be copied in; 0 = true zero-copy
  explicit operator bool() const noexcept { return code == Errc::ok; }
};

namespace detail {

/// Keeps one thread's allocations in the shared heap from borrow to publish. May be closed by
/// another thread: then the first one is told, and goes back to its ordinary heap at its next
/// borrow or publish.
class AGNOCAST_PUBLIC LoanScope {
 public:
  LoanScope() noexcept = default;
  LoanScope(const LoanScope&) = delete;
  LoanScope& operator=(const LoanScope&) = delete;
  ~LoanScope() { close(); }
  void open() noexcept;
  void close() noexcept;

 private:
  struct Home;
  static Home*& current() noexcept;  // of the calling thread
  Home* home_ = nullptr;
};

class AGNOCAST_PUBLIC UntypedPublisher {
 public:
  [[nodiscard]] static Result<std::shared_ptr<UntypedPublisher>> create(
      const EndpointName& name, MessageType type, const QoS& qos, void (*destroy)(void*) noexcept);
  ~UntypedPublisher();
  UntypedPublisher(const UntypedPublisher&) = delete;
  UntypedPublisher& operator=(const UntypedPublisher&) = delete;

  Errc publish(void* message, std::size_t bytes) noexcept;
  /// What make_resident did, unless nothing was foreign; for agnocast-ctl.
  void count_adoption(const Result<std::uint64_t>& adopted) noexcept;
  SharedHeap heap() const noexcept;
  const MessageType& type() const noexcept { return type_; }
  const std::string& topic() const noexcept { return topic_; }
  std::size_t subscription_count() const noexcept;

 private:
  UntypedPublisher(MessageType type, std::string topic) noexcept
      : type_(std::move(type)), topic_(std::move(topic)) {}
  MessageType type_;
  std::string topic_;
  std::shared_ptr<PublisherEndpoint> endpoint_;
};

}  // namespace detail

/// Any thread may call anything; publishes of one publisher are ordered by a private mutex.
template <class T>
class Publisher {
 public:
  using SharedPtr = std::shared_ptr<Publisher>;

  /// For create_publisher.
  explicit Publisher(std::shared_ptr<detail::UntypedPublisher> untyped) noexcept
      : untyped_(std::move(untyped)) {}

  /// A message to fill. From here to publish (or its destruction) this thread allocates from the
  /// shared heap; many loans at once are fine. If the heap is full the memory comes from libc and
  /// publish says heap_exhausted. Throws what T's constructor throws, and std::bad_alloc.
  ipc_shared_ptr<T> borrow_loaned_message() {
    auto loan = std::make_unique<Loan>();
    loan->origin = untyped_.get();
    loan->end = [](detail::Block* block) noexcept { delete static_cast<Loan*>(block); };
    loan->scope.open();
    loan->message = new T();
    return ipc_shared_ptr<T>(loan.release());
  }

  /// Commits a loan of this publisher; every copy of the handle becomes empty. On failure `message`
  /// is as before.
  PublishResult publish(ipc_shared_ptr<T>&& message) noexcept {
    auto* const loan = static_cast<Loan*>(message.block());
    if (loan == nullptr || loan->message == nullptr || loan->origin != untyped_.get())
      return {Errc::loan_invalid, 0};
    std::unique_ptr<T> object(static_cast<T*>(std::exchange(loan->message, nullptr)));
    const PublishResult result = publish(std::move(object));
    if (result) {
      loan->scope.close();
      message.reset();
    } else {
      loan->message = object.release();
    }
    return result;
  }

  /// Commits a message that was made anywhere. What of it lies outside the shared heap is adopted.
  /// On failure `message` is as before.
  PublishResult publish(std::unique_ptr<T>&& message) noexcept {
    if (message == nullptr) return {Errc::loan_invalid, 0};
    const Result<std::uint64_t> adopted =
        make_resident(message, untyped_->type(), untyped_->heap());
    if (!adopted || *adopted != 0) untyped_->count_adoption(adopted);
    if (!adopted) return {adopted.error().code, 0};
    const Errc code = untyped_->publish(message.get(), sizeof(T));
    if (code == Errc::ok) (void)message.release();
    return {code, *adopted};
  }

  /// The same, for callers that must look at the result.
  [[nodiscard]] PublishResult try_publish(ipc_shared_ptr<T>&& message) noexcept {
    return publish(std::move(message));
  }
  [[nodiscard]] PublishResult try_publish(std::unique_ptr<T>&& message) noexcept {
    return publish(std::move(message));
  }

  const char* get_topic_name() const noexcept { return untyped_->topic().c_str(); }
  /// Matched subscriptions that this process has mapped; a moment ago.
  std::size_t get_subscription_count() const noexcept { return untyped_->subscription_count(); }

 private:
  struct Loan : detail::Block {
    ~Loan() { delete static_cast<T*>(message); }
    detail::LoanScope scope;  // closed after the message is gone: member order
  };
  std::shared_ptr<detail::UntypedPublisher> untyped_;
};

/// A publisher, or why there is none. Errors: daemon_not_running, hook_missing, hook_ineffective,
/// invalid_name, type_mismatch, type_refused, depth_refused, quota_exceeded, permission_denied, …
/// (include/agnocast/error.hpp).
template <class T, class Node>
[[nodiscard]] Result<typename Publisher<T>::SharedPtr> try_create_publisher(
    Node&& node, const std::string& topic, const QoS& qos) {
  Result<detail::EndpointName> name = detail::resolve(detail::dereference(node), topic);
  if (!name) return tl::unexpected<Failure>(name.error());
  Result<MessageType> type = message_type_of<T>();
  if (!type) return tl::unexpected<Failure>(type.error());
  auto untyped = detail::UntypedPublisher::create(
      *name, std::move(*type), qos,
      [](void* message) noexcept { delete static_cast<T*>(message); });
  if (!untyped) return tl::unexpected<Failure>(untyped.error());
  return std::make_shared<Publisher<T>>(std::move(*untyped));
}

/// The same; throws agnocast::Error.
template <class T, class Node>
typename Publisher<T>::SharedPtr create_publisher(Node&& node, const std::string& topic,
                                                  const QoS& qos) {
  auto publisher = try_create_publisher<T>(node, topic, qos);
  if (!publisher) throw Error(publisher.error());
  return std::move(*publisher);
}
template <class T, class Node>
typename Publisher<T>::SharedPtr create_publisher(Node&& node, const std::string& topic,
                                                  std::size_t depth) {
  return create_publisher<T>(node, topic, QoS(depth));
}

}  // namespace agnocast
