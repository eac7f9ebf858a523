// SPDX-License-Identifier: Apache-2.0
//
// Publisher: borrow a message, fill it by the means of its type, publish it. Nothing is copied or
// serialized, except memory outside the shared heap: such a message is adopted (copied once, and
// the result reports it).
#pragma once

#include <agnocast/callback_group.hpp>
#include <agnocast/core_namespace.hpp>
#include <agnocast/events.hpp>
#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/lender.hpp>
#include <agnocast/message_type.hpp>
#include <agnocast/message_windows.hpp>
#include <agnocast/node_adapter.hpp>
#include <agnocast/node_like.hpp>
#include <agnocast/qos.hpp>
#include <agnocast/residency.hpp>
#include <agnocast/result.hpp>
#include <agnocast/shared_allocator.hpp>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace agnocast {

class PublisherEndpoint;
class CallbackSource;
class Watch;

AGNOCAST_CORE_BEGIN

/// Options of a publisher: its event callbacks (events.hpp) and their callback group
/// (callback_group.hpp).
class PublisherOptions : public detail::EventOptions<PublisherOptions>,
                         public detail::CallbackGroupOption<PublisherOptions> {
 public:
  /// In a process without the heap hook, each message is copied once, into the shared heap. false:
  /// the publisher is not created there (hook_missing).
  PublisherOptions& allow_copy(bool allows) noexcept {
    may_copy_ = allows;
    return *this;
  }
  bool may_copy() const noexcept { return may_copy_; }
  PublisherOptions& liveliness_callback(std::function<void(LivelinessLostInfo&)> callback) {
    return events_.liveliness_lost = std::move(callback), *this;
  }

 private:
  bool may_copy_ = true;
};

AGNOCAST_CORE_END

namespace detail {

/// Sleeps between attempts, ever longer up to a millisecond, until the timeout.
class Timeout {
 public:
  template <class Rep, class Period>
  explicit Timeout(std::chrono::duration<Rep, Period> timeout) noexcept {
    // A year stands for "no limit", and an end that can be computed.
    constexpr auto for_ever = std::chrono::hours(24 * 365);
    end_ = std::chrono::steady_clock::now() +
           (timeout < for_ever
                ? std::chrono::duration_cast<std::chrono::steady_clock::duration>(timeout)
                : std::chrono::steady_clock::duration(for_ever));
  }
  /// Returns false, without sleeping, when the time is up.
  AGNOCAST_PUBLIC bool wait() noexcept;

 private:
  std::chrono::steady_clock::time_point end_;
  std::chrono::microseconds step_{10};
};

/// The parts of a message type that only the user's translation unit knows.
struct MessageCode {
  MessageEnd end;
  bool uses_shared_allocator;
};

/// Opens the shared heap for messages of this type. Errors as of create_publisher.
[[nodiscard]] Result<void> prepare_to_publish(const MessageType& type, const MessageCode& code);

/// A message in one block of the shared heap, in a process without the hook; without a message,
/// code() is the reason. Frees the block, unless it was published.
class AGNOCAST_PUBLIC BlockCopy {
 public:
  explicit BlockCopy(Errc code) noexcept : code_(code) {}
  BlockCopy(void* start, std::uint64_t bytes) noexcept : start_(start), bytes_(bytes) {}
  BlockCopy(BlockCopy&& other) noexcept
      : start_(std::exchange(other.start_, nullptr)), bytes_(other.bytes_), code_(other.code_) {}
  BlockCopy& operator=(BlockCopy&& other) noexcept {
    std::swap(start_, other.start_);
    bytes_ = other.bytes_;
    code_ = other.code_;
    return *this;
  }
  ~BlockCopy();
  void* start() const noexcept { return start_; }
  /// Returns the size of the message.
  std::uint64_t bytes() const noexcept { return bytes_; }
  void set_bytes(std::uint64_t bytes) noexcept { bytes_ = bytes; }
  Errc code() const noexcept { return code_; }
  void release() noexcept { start_ = nullptr; }

 private:
  void* start_ = nullptr;
  std::uint64_t bytes_ = 0;
  Errc code_ = Errc::ok;
};

class AGNOCAST_PUBLIC UntypedPublisher {
 public:
  [[nodiscard]] static Result<std::shared_ptr<UntypedPublisher>> create(
      const EndpointName& name, MessageType type, const QoS& qos,
      const core::PublisherOptions& options, const MessageCode& code);
  ~UntypedPublisher();
  UntypedPublisher(const UntypedPublisher&) = delete;
  UntypedPublisher& operator=(const UntypedPublisher&) = delete;

  /// Bounds the time that its destructor waits for the daemon. Do not call it while another
  /// thread may destroy this object.
  void end_by(std::chrono::steady_clock::time_point end) noexcept { end_ = end; }
  /// See EndpointName::announces_persistent_id_later.
  void announce_persistent_id() noexcept;

  /// Returns ok, or why nothing can be published: shut_down in a forked child, switched_off,
  /// revoked.
  Errc state() const noexcept;
  /// Publishes `message_bytes` bytes; `object_bytes` of them are the message object itself.
  Errc publish(void* message, std::size_t object_bytes, std::uint64_t message_bytes) noexcept;
  /// Returns whether this process has no hook: messages are copied into blocks, and published so.
  bool copies() const noexcept { return copies_; }
  /// Copies a message; counts the outcome as count_adoption(). Errors: those of publish();
  /// loan_invalid: another thread changes the message.
  BlockCopy copy(const void* message) noexcept;
  /// Returns whether there is a copy, in a window that messages are published from.
  bool is_current(const BlockCopy& copy) const noexcept;
  /// Publishes it; on failure `copy` is unchanged.
  PublishResult publish(BlockCopy& copy) noexcept;
  /// Destroys old messages that publish has deferred. Call it before borrowing or adopting a
  /// message.
  void make_room() const noexcept;
  /// For a full heap: destroys every unneeded old message of this process, also those of other
  /// publishers. Returns false if there was none. The next make_room() does the same, because a
  /// borrow may come before the next publish.
  bool has_more_room() const noexcept;
  /// Counts an outcome of make_resident for agnocast-ctl, unless nothing was foreign.
  void count_adoption(const Result<Adoption>& adopted) noexcept;
  SharedHeap heap() const noexcept;
  LenderId lender() const noexcept { return lender_; }
  const MessageType& type() const noexcept { return type_; }
  const std::string& topic() const noexcept { return topic_; }
  const QoS& qos() const noexcept { return qos_; }
  bool wait_for_all_acked(Timeout timeout) const noexcept;
  bool wait_for_local_links(Timeout timeout) const noexcept;
  std::size_t subscription_count() const noexcept;
  /// Returns how many of these are of this process.
  std::size_t local_subscription_count() const noexcept;
  /// Returns how many have mapped this publisher and are mapped here; also those that have left,
  /// until they hold no message.
  std::size_t linked_subscription_count() const noexcept;
  std::uint64_t callback_exception_count() const noexcept;
  MatchedInfo matched_status() noexcept;
  IncompatibleQosInfo incompatible_qos_status() noexcept;
  DeadlineMissedInfo deadline_missed_status() noexcept;
  std::chrono::steady_clock::time_point event_due() const noexcept;
  LivelinessLostInfo liveliness_lost_status() noexcept;
  bool assert_liveliness() noexcept;
  IncompatibleTypeInfo incompatible_type_status() noexcept;
  HeapCollisionInfo heap_collision_status() noexcept;
  bool is_active() const noexcept;
  /// Returns the persistent endpoint id (EndpointName::persistent_id); 0: switched off.
  std::uint64_t persistent_id() const noexcept;
  /// Returns the persistent ids of the subscriptions that receive messages published from now on.
  std::vector<std::uint64_t> reader_persistent_ids() const;
  /// Returns what MessageInfo::publisher of its next message is; 0: switched off.
  std::uint64_t generation() const noexcept;
  /// Registers `watch`, which is notified when matched endpoints change.
  void tell(std::shared_ptr<Watch> watch) noexcept;

 private:
  UntypedPublisher(MessageType type, std::string topic, const QoS& qos) noexcept
      : type_(std::move(type)), topic_(std::move(topic)), qos_(qos) {}
  const LenderId lender_;
  MessageType type_;
  std::string topic_;
  QoS qos_;
  bool copies_ = false;
  std::chrono::steady_clock::time_point end_ = std::chrono::steady_clock::time_point::max();
  std::shared_ptr<PublisherEndpoint> endpoint_;
  CallbackGroup::SharedPtr group_;  // this and the next only with event callbacks
  std::shared_ptr<CallbackSource> source_;
};

}  // namespace detail

/// Functions common to all publishers. Any thread may call any of them.
class PublisherBase {
 public:
  /// Returns false if AGNOCAST=off was in the environment at creation (all calls still work, and
  /// publish returns switched_off), or the session of the process was revoked (publish returns
  /// revoked).
  bool is_active() const noexcept { return untyped_->is_active(); }
  const char* get_topic_name() const noexcept { return untyped_->topic().c_str(); }
  /// Returns what MessageInfo::publisher of its next message is: unique among the publishers of
  /// the daemon's life, another one after the daemon has lost its store. 0: switched off.
  std::uint64_t get_generation() const noexcept { return untyped_->generation(); }
  /// Returns the QoS that the publisher offers; it converts to an rclcpp::QoS.
  QoS get_actual_qos() const noexcept { return untyped_->qos(); }
  /// Waits until each matched reliable subscription has taken what was published before this call,
  /// or can no longer take it; a negative timeout means without limit. Returns false if time ran
  /// out, or nothing can be taken any more: the session was revoked, or this is a forked child.
  /// Looks at the subscriptions every millisecond. A stopped process holds it up, and while
  /// agnocastd is away a subscription that has ended as well. After agnocastd has lost its store
  /// more than once, queues in between the first and the present one are not waited for.
  template <class Rep = std::int64_t, class Period = std::milli>
  bool wait_for_all_acked(
      std::chrono::duration<Rep, Period> timeout = std::chrono::milliseconds(-1)) const noexcept {
    return timeout < timeout.zero()
               ? untyped_->wait_for_all_acked(detail::Timeout(std::chrono::hours::max()))
               : untyped_->wait_for_all_acked(detail::Timeout(timeout));
  }
  /// Waits until each matched subscription of this process can take the next message at once, as
  /// it can where DDS matches within a process; usually a millisecond. Returns false if time ran
  /// out, or the session was revoked, or this is a forked child.
  bool wait_for_local_links(std::chrono::nanoseconds timeout) const noexcept {
    return untyped_->wait_for_local_links(detail::Timeout(timeout));
  }
  /// Returns the number of matched subscriptions, which receive messages published from now on.
  /// One counts as soon as its creation has returned, in any process. Costs a look at each place
  /// of the topic, microseconds at most; allocates nothing.
  std::size_t get_subscription_count() const noexcept { return untyped_->subscription_count(); }
  /// Returns how many subscriptions have mapped this publisher's memory and are mapped here, which
  /// takes some milliseconds: they can take the next message at once. One that has left counts
  /// until it holds no message. For measurements and tests.
  std::size_t get_linked_subscription_count() const noexcept {
    return untyped_->linked_subscription_count();
  }
  /// Returns the number of exceptions thrown by event callbacks in a BackgroundExecutor (see
  /// Subscription).
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
  LivelinessLostInfo get_liveliness_lost_status() noexcept {
    return untyped_->liveliness_lost_status();
  }
  /// Says that this publisher is alive, as a publish does; for liveliness manual_by_topic. No
  /// system call. Returns false if it is not active.
  bool assert_liveliness() noexcept { return untyped_->assert_liveliness(); }
  IncompatibleTypeInfo get_type_mismatch_status() noexcept {
    return untyped_->incompatible_type_status();
  }
  HeapCollisionInfo get_heap_collision_status() noexcept {
    return untyped_->heap_collision_status();
  }

 protected:
  explicit PublisherBase(std::shared_ptr<detail::UntypedPublisher> untyped) noexcept
      : untyped_(std::move(untyped)) {}
  ~PublisherBase() = default;
  detail::UntypedPublisher& untyped() const noexcept { return *untyped_; }

 private:
  std::shared_ptr<detail::UntypedPublisher> untyped_;
};

namespace detail {

/// Commits a message in the shared heap. On failure `message` is unchanged.
template <class Code>
Errc commit_resident(UntypedPublisher& publisher, const Code& code, typename Code::Owner& message,
                     std::uint64_t message_bytes) noexcept {
  const Errc outcome = publisher.publish(code.start_of(message.get()), code.bytes(), message_bytes);
  if (outcome == Errc::ok) (void)message.release();
  return outcome;
}

/// Commits a message with parts outside the shared heap, as check_residency() has `found`. Not
/// inlined: publish seldom needs it, and would get longer for each message type.
template <class Code>
[[gnu::noinline]] PublishResult commit_foreign(UntypedPublisher& publisher, const Code& code,
                                               typename Code::Owner& message,
                                               const Residency& found, const SharedHeap& heap,
                                               BlockCopy* kept) noexcept {
  if (publisher.copies()) {
    BlockCopy mine(Errc::ok);
    BlockCopy& copy = kept != nullptr ? *kept : mine;
    const bool is_kept = publisher.is_current(copy);
    if (!is_kept) copy = publisher.copy(message.get());
    PublishResult result = publisher.publish(copy);
    if (is_kept) result.adopted_bytes = 0;
    if (result) message.reset();
    return result;
  }
  const Result<Adoption> adopted = adopt_by(
      code, [&] { publisher.make_room(); }, [&] { return publisher.has_more_room(); }, message,
      found, publisher.type(), heap);
  publisher.count_adoption(adopted);
  if (!adopted) return {adopted.error().code, 0};
  return {commit_resident(publisher, code, message, adopted->message_bytes),
          adopted->adopted_bytes};
}

/// Commits a message that was made anywhere; adopts it if parts are outside the shared heap. On
/// failure `message` is unchanged. `Code` as for Lender. `kept`: where a copy in a block is kept
/// for the next attempt with the same message; may be null.
template <class Code>
PublishResult commit(UntypedPublisher& publisher, const Code& code, typename Code::Owner&& message,
                     BlockCopy* kept = nullptr) noexcept {
  if (const Errc state = publisher.state(); state != Errc::ok) return {state, 0};
  if (message == nullptr) return {Errc::loan_invalid, 0};
  const SharedHeap heap = publisher.heap();
  const Residency found =
      check_residency(publisher.type(), message.get(), heap.windows(heap.context));
  if (!found.is_resident()) return commit_foreign(publisher, code, message, found, heap, kept);
  return {commit_resident(publisher, code, message, found.message_bytes), 0};
}

/// Loans and their commit, for typed and generic publishers.
template <class T, class Code>
class LendingPublisher : public PublisherBase, public Lender<T, Code> {
 public:
  using typename Lender<T, Code>::Owner;

  /// Commits a loan of this publisher; every copy of the handle becomes empty, also in other
  /// threads. Publishing a second copy, even at the same time, returns loan_invalid. A thread
  /// that still writes to the message then writes to memory that subscriptions read, or (without
  /// the heap hook) that is freed. On failure `message` is unchanged, though an adopted message has
  /// moved.
  PublishResult publish(ipc_shared_ptr<T>&& message) noexcept {
    return attempt(std::move(message), nullptr);
  }

  /// Commits a message that was made anywhere; adopts it if parts are outside the shared heap. On
  /// failure `message` is unchanged.
  PublishResult publish(Owner&& message) noexcept { return attempt(std::move(message), nullptr); }

  /// Publishes to keep-all subscriptions: while one has not read enough (would_block), retries
  /// for at most `timeout`, at least once. Nothing wakes a publisher, so it polls: 10 µs after
  /// the first refusal, then less and less often, at last every millisecond. A long wait
  /// therefore costs a thousand short checks a second, and ends up to a millisecond late.
  template <class Message, class Rep, class Period>
  PublishResult publish_for(Message&& message,
                            std::chrono::duration<Rep, Period> timeout) noexcept {
    static_assert(!std::is_lvalue_reference_v<Message>, "publish_for(std::move(message), timeout)");
    Timeout limit(timeout);
    std::uint64_t adopted_bytes = 0;
    BlockCopy kept(Errc::ok);
    for (;;) {
      // attempt() keeps it unless it succeeds.
      // NOLINTNEXTLINE(bugprone-move-forwarding-reference,bugprone-use-after-move)
      PublishResult result = attempt(std::move(message), &kept);
      result.adopted_bytes = adopted_bytes += result.adopted_bytes;
      if (result.code != Errc::would_block || !limit.wait()) return result;
    }
  }

  /// The same as publish, for callers that must check the result.
  [[nodiscard]] PublishResult try_publish(ipc_shared_ptr<T>&& message) noexcept {
    return publish(std::move(message));
  }
  [[nodiscard]] PublishResult try_publish(Owner&& message) noexcept {
    return publish(std::move(message));
  }

 protected:
  explicit LendingPublisher(std::shared_ptr<UntypedPublisher> untyped, Code code = {}) noexcept
      : PublisherBase(std::move(untyped)), Lender<T, Code>(this->untyped().lender(), code) {}
  ~LendingPublisher() = default;

  /// publish(); see commit() for `kept`.
  PublishResult attempt(ipc_shared_ptr<T>&& message, BlockCopy* kept) noexcept {
    return this->take_back(std::move(message), [&](Owner&& object) {
      return commit(untyped(), this->code(), std::move(object), kept);
    });
  }
  PublishResult attempt(Owner&& message, BlockCopy* kept) noexcept {
    return commit(untyped(), this->code(), std::move(message), kept);
  }

  /// A copy in the shared heap, as a message or as a block; without either, `code` is the reason.
  struct Copied {
    Owner message;
    std::uint64_t bytes = 0;
    Errc code = Errc::ok;
    BlockCopy block{Errc::ok};
  };
  template <class Object>
  Copied copy_in(const Object& message) noexcept {
    return copy_in(this->code(), message);
  }
  template <class CopyCode, class Object>
  Copied copy_in(const CopyCode& code, const Object& message) noexcept {
    UntypedPublisher& publisher = untyped();
    if (const Errc state = publisher.state(); state != Errc::ok) return {nullptr, 0, state};
    if (publisher.copies()) return copy_block(code, message);
    publisher.make_room();
    auto copy = copy_into_heap(
        code, message, [&] { return publisher.has_more_room(); }, publisher.type(),
        publisher.heap());
    if (!copy) {
      publisher.count_adoption(tl::unexpected<Failure>(copy.error()));
      return {nullptr, 0, copy.error().code};
    }
    publisher.count_adoption(Adoption{copy->message_bytes, copy->message_bytes});
    return {std::move(copy->message), copy->message_bytes};
  }
  /// copy_in() without the hook. What `CopyCode` has to check, it copies to private memory first.
  template <class CopyCode, class Object>
  Copied copy_block(const CopyCode& code, const Object& message) noexcept {
    const auto copied = [this](const void* original) noexcept -> Copied {
      BlockCopy block = untyped().copy(original);
      return {nullptr, block.bytes(), block.code(), std::move(block)};
    };
    if constexpr (std::is_same_v<CopyCode, Code>) {
      return copied(std::addressof(message));
    } else {
      return guarded([&]() -> Copied { return copied(code.copy(message).get()); },
                     []() -> Copied {
                       return {nullptr, 0, Errc::heap_exhausted};
                     },
                     []() -> Copied {
                       return {nullptr, 0, Errc::user_code_threw};
                     });
    }
  }
  PublishResult publish_copy(Copied&& copy) noexcept {
    if (copy.block.start() != nullptr) return untyped().publish(copy.block);
    if (copy.message == nullptr) return {copy.code, 0};
    if (const Errc state = untyped().state(); state != Errc::ok) return {state, copy.bytes};
    return {commit_resident(untyped(), this->code(), copy.message, copy.bytes), copy.bytes};
  }

  // Hides Lender's, which clients and services use: their next publish destroys their old
  // messages.
  ipc_shared_ptr<T> lend() {
    untyped().make_room();
    return Lender<T, Code>::lend();
  }
};

/// Copies messages of an untrusted publisher, of a type with a table. Sets `is_whole` to false
/// for a message that refers to memory outside `windows`; the copy is then useless.
template <class T>
struct CheckedCode : TypedCode<T> {
  static constexpr bool copy_may_throw = true;
  const WindowSet& windows;
  bool& is_whole;
  CheckedCode(const WindowSet& within, bool& whole) noexcept : windows(within), is_whole(whole) {}
  typename TypedCode<T>::Owner copy(const T& original) const {
    auto made = this->make();
    is_whole = MessageTraits<T>::copy_checked(original, *made, windows);
    return made;
  }
};

}  // namespace detail

AGNOCAST_CORE_BEGIN

/// Any thread may call any function; a private mutex orders the publishes of one publisher.
template <class T>
class Publisher : public detail::LendingPublisher<T, detail::TypedCode<T>> {
  using Base = detail::LendingPublisher<T, detail::TypedCode<T>>;

 public:
  using SharedPtr = std::shared_ptr<Publisher>;

  /// For create_publisher.
  explicit Publisher(std::shared_ptr<detail::UntypedPublisher> untyped) noexcept
      : Base(std::move(untyped)) {}

  /// Lends a message to fill. From here to publish (or its destruction) this thread allocates
  /// from the shared heap (with the heap hook); it may have many loans at once, and LoanScope
  /// extends one to other threads. If the heap is full, the memory comes from libc and publish
  /// returns heap_exhausted. Like publish it destroys old messages: hold no lock that their
  /// destructors need. Throws what T's constructor throws, and std::bad_alloc.
  ipc_shared_ptr<T> borrow_loaned_message() {
    static_assert(std::is_default_constructible_v<T>,
                  "agnocast: this message has no default constructor, so it cannot be borrowed; "
                  "publish a std::unique_ptr of it");
    return this->lend();
  }

  using Base::publish;
  /// Publishes a copy made in the shared heap: for a message that the caller keeps, or forwards
  /// after receiving it. `adopted_bytes` is its whole size; with the heap hook a loan or a
  /// std::unique_ptr costs less. Errors as of the other overloads without loan_invalid; and
  /// protocol_violation: a received rosidl message refers to memory outside its publisher's
  /// (docs/messages.md, Forwarding).
  PublishResult publish(const T& message) noexcept { return this->publish_copy(copy_of(message)); }
  using Base::try_publish;
  [[nodiscard]] PublishResult try_publish(const T& message) noexcept { return publish(message); }
  /// publish_for with a message that the caller keeps: copies it once, however often it retries.
  template <class Rep, class Period>
  PublishResult publish_for(const T& message, std::chrono::duration<Rep, Period> timeout) noexcept {
    detail::Timeout limit(timeout);
    auto copy = copy_of(message);
    for (;;) {
      const PublishResult result = this->publish_copy(std::move(copy));
      if (result.code != Errc::would_block || !limit.wait()) return result;
    }
  }
  template <class Message, class Rep, class Period,
            class = std::enable_if_t<!std::is_same_v<std::decay_t<Message>, T>>>
  PublishResult publish_for(Message&& message,
                            std::chrono::duration<Rep, Period> timeout) noexcept {
    return Base::publish_for(std::forward<Message>(message), timeout);
  }

 private:
  auto copy_of(const T& message) noexcept {
    if constexpr (detail::is_described<T>) {
      const WindowSet windows = detail::windows_of_another(&message);
      if (windows.count() != 0) {
        bool is_whole = true;
        auto copy = this->copy_in(detail::CheckedCode<T>(windows, is_whole), message);
        if (!is_whole) return decltype(copy){nullptr, 0, Errc::protocol_violation};
        return copy;
      }
    }
    return this->copy_in(message);
  }
};

/// Creates a publisher. Errors: daemon_not_running, hook_missing, hook_ineffective, invalid_name,
/// type_mismatch, type_refused, depth_refused, quota_exceeded, access_denied, …
/// (include/agnocast/error.hpp).
template <class T, class Node>
[[nodiscard]] Result<typename Publisher<T>::SharedPtr> try_create_publisher(
    Node&& node, const std::string& topic, const QoS& qos,
    const detail::PublisherOptionsOf<Node>& options = {}) {
  Result<detail::EndpointName> name = detail::resolve(detail::dereference(node), topic);
  if (!name) return tl::unexpected<Failure>(name.error());
  Result<MessageType> type = message_type_of<T>();
  if (!type) return tl::unexpected<Failure>(type.error());
  QoS used = qos;
  const Result<PublisherOptions> adapted =
      detail::AdapterOf<Node>::options(detail::dereference(node), *name, used, options);
  if (!adapted) return tl::unexpected<Failure>(adapted.error());
  auto untyped = detail::UntypedPublisher::create(
      *name, std::move(*type), used, *adapted,
      detail::MessageCode{detail::MessageEnd::of<T>(), std::is_base_of_v<SharedMessage, T>});
  if (!untyped) return tl::unexpected<Failure>(untyped.error());
  return std::make_shared<Publisher<T>>(std::move(*untyped));
}

/// The same; throws agnocast::Error.
template <class T, class Node>
typename Publisher<T>::SharedPtr create_publisher(
    Node&& node, const std::string& topic, const QoS& qos,
    const detail::PublisherOptionsOf<Node>& options = {}) {
  auto publisher = try_create_publisher<T>(node, topic, qos, options);
  if (!publisher) detail::throw_error(publisher.error());
  return std::move(*publisher);
}

AGNOCAST_CORE_END

}  // namespace agnocast
