// SPDX-License-Identifier: Apache-2.0
//
// Publisher: borrow a message, fill it with whatever its type can do, publish it. Nothing is copied
// and nothing serialized; what was built outside the shared heap is adopted (copied once, and said
// so).
#pragma once

#include <agnocast/events.hpp>
#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/message_type.hpp>
#include <agnocast/message_windows.hpp>
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
class Runner;
class CallbackSource;
class Watch;

/// Options of a publisher: its event callbacks (events.hpp).
class PublisherOptions : public detail::EventOptions<PublisherOptions> {};

/// What publish did. Converts to true when the message was committed; then it is the queue's.
/// Otherwise the caller still has it.
struct PublishResult {
  /// ok, no_slot, would_block, heap_exhausted, window_exhausted, loan_invalid, user_code_threw,
  /// protocol_violation, shut_down (in a forked child), switched_off, revoked
  Errc code = Errc::ok;
  std::uint64_t adopted_bytes =
      0;  ///< bytes outside the shared heap that had to be copied in; 0 = true zero-copy
  explicit operator bool() const noexcept { return code == Errc::ok; }
};

namespace detail {

/// Keeps one thread's allocations in the shared heap from borrow to publish. May be closed by
/// another thread: then the first one is told, and goes back to its ordinary heap at its next
/// borrow or publish.
class AGNOCAST_PUBLIC BorrowScope {
 public:
  BorrowScope() noexcept = default;
  BorrowScope(const BorrowScope&) = delete;
  BorrowScope& operator=(const BorrowScope&) = delete;
  ~BorrowScope() { close(); }
  void open() noexcept;
  void close() noexcept;

 private:
  struct Home;
  static Home*& current() noexcept;  // of the calling thread
  Home* home_ = nullptr;
};

/// Tells the loans of one publisher, service or client of this process from all others'. No address
/// does: a loan may outlive its lender, and another one be made in the same place.
class LenderId {
 public:
  /// One that nobody had before.
  AGNOCAST_PUBLIC LenderId() noexcept;
  std::uint64_t value() const noexcept { return value_; }

 private:
  std::uint64_t value_;  // counted from 1; they do not run out
};

/// Sleeps between attempts, ever longer up to a millisecond, until the time is up.
class Patience {
 public:
  template <class Rep, class Period>
  explicit Patience(std::chrono::duration<Rep, Period> timeout) noexcept {
    // A year is for ever, and an end that can be computed.
    constexpr auto for_ever = std::chrono::hours(24 * 365);
    end_ = std::chrono::steady_clock::now() +
           (timeout < for_ever
                ? std::chrono::duration_cast<std::chrono::steady_clock::duration>(timeout)
                : std::chrono::steady_clock::duration(for_ever));
  }
  /// False when the time is up; then it did not sleep.
  AGNOCAST_PUBLIC bool wait() noexcept;

 private:
  std::chrono::steady_clock::time_point end_;
  std::chrono::microseconds step_{10};
};

/// What only the user's translation unit knows about a message type.
struct MessageCode {
  MessageEnd end;
  bool uses_shared_allocator;
};

class AGNOCAST_PUBLIC UntypedPublisher {
 public:
  [[nodiscard]] static Result<std::shared_ptr<UntypedPublisher>> create(
      const EndpointName& name, MessageType type, const QoS& qos, const PublisherOptions& options,
      const MessageCode& code);
  ~UntypedPublisher();
  UntypedPublisher(const UntypedPublisher&) = delete;
  UntypedPublisher& operator=(const UntypedPublisher&) = delete;

  /// Its destructor waits no longer for the daemon than until then. Not while another thread may
  /// destroy it.
  void end_by(std::chrono::steady_clock::time_point end) noexcept { end_ = end; }
  /// See EndpointName::says_lineage_later.
  void say_lineage() noexcept;

  /// ok; shut_down in a forked child, switched_off, revoked: nothing can be published.
  Errc state() const noexcept;
  /// `object_bytes` of `message_bytes` are the message object itself.
  Errc publish(void* message, std::size_t object_bytes, std::uint64_t message_bytes) noexcept;
  /// Before a message is borrowed or adopted: destroys old ones that publish has left to be destroyed.
  void make_room() const noexcept;
  /// The heap is full: destroys every old message of this process that nobody needs any more, those of
  /// other publishers too. False: there was none. The next make_room() does the same, as a borrow may
  /// come before the next publish.
  bool has_more_room() const noexcept;
  /// What make_resident did, unless nothing was foreign; for agnocast-ctl.
  void count_adoption(const Result<Adoption>& adopted) noexcept;
  SharedHeap heap() const noexcept;
  LenderId lender() const noexcept { return lender_; }
  const MessageType& type() const noexcept { return type_; }
  const std::string& topic() const noexcept { return topic_; }
  std::size_t subscription_count() const noexcept;
  std::uint64_t callback_exception_count() const noexcept;
  MatchedInfo matched_status() noexcept;
  IncompatibleQosInfo incompatible_qos_status() noexcept;
  IncompatibleTypeInfo incompatible_type_status() noexcept;
  HeapCollisionInfo heap_collision_status() noexcept;
  bool is_active() const noexcept;
  /// See EndpointName::lineage; 0: switched off.
  std::uint64_t lineage() const noexcept;
  /// Of the subscriptions that get what is published from now on.
  std::vector<std::uint64_t> reader_lineages() const;
  /// `watch` is told when what is matched has changed.
  void tell(std::shared_ptr<Watch> watch) noexcept;

 private:
  UntypedPublisher(MessageType type, std::string topic) noexcept
      : type_(std::move(type)), topic_(std::move(topic)) {}
  const LenderId lender_;
  MessageType type_;
  std::string topic_;
  std::chrono::steady_clock::time_point end_ = std::chrono::steady_clock::time_point::max();
  std::shared_ptr<PublisherEndpoint> endpoint_;
  std::shared_ptr<Runner> runner_;  // this and the next only with event callbacks
  std::shared_ptr<CallbackSource> source_;
};

}  // namespace detail

/// What all publishers can say. Any thread may call anything.
class PublisherBase {
 public:
  /// False when AGNOCAST=off was in the environment as this was created (it can be used as always, and
  /// publish says switched_off), and when the membership of the process was revoked (publish says
  /// revoked).
  bool is_active() const noexcept { return untyped_->is_active(); }
  const char* get_topic_name() const noexcept { return untyped_->topic().c_str(); }
  /// Matched subscriptions: each gets what is published from now on.
  std::size_t get_subscription_count() const noexcept { return untyped_->subscription_count(); }
  /// Of event callbacks, in the library's thread (see Subscription).
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

 protected:
  explicit PublisherBase(std::shared_ptr<detail::UntypedPublisher> untyped) noexcept
      : untyped_(std::move(untyped)) {}
  ~PublisherBase() = default;
  detail::UntypedPublisher& untyped() const noexcept { return *untyped_; }

 private:
  std::shared_ptr<detail::UntypedPublisher> untyped_;
};

namespace detail {

/// Commits a message that lies in the shared heap. On failure `message` is as before.
template <class Code>
Errc commit_resident(UntypedPublisher& publisher, const Code& code, typename Code::Owner& message,
                     std::uint64_t message_bytes) noexcept {
  const Errc outcome = publisher.publish(code.start_of(message.get()), code.bytes(), message_bytes);
  if (outcome == Errc::ok) (void)message.release();
  return outcome;
}

/// Commits a message that was made anywhere. What of it lies outside the shared heap is adopted. On
/// failure `message` is as before. `Code` as for Lender.
template <class Code>
PublishResult commit(UntypedPublisher& publisher, const Code& code,
                     typename Code::Owner&& message) noexcept {
  if (const Errc state = publisher.state(); state != Errc::ok) return {state, 0};
  if (message == nullptr) return {Errc::loan_invalid, 0};
  const Result<Adoption> adopted = make_resident_by(
      code, [&] { publisher.make_room(); }, [&] { return publisher.has_more_room(); }, message,
      publisher.type(), publisher.heap());
  if (!adopted || adopted->adopted_bytes != 0) publisher.count_adoption(adopted);
  if (!adopted) return {adopted.error().code, 0};
  return {commit_resident(publisher, code, message, adopted->message_bytes),
          adopted->adopted_bytes};
}

/// Lends messages and takes them back. `Code` makes, copies, owns and measures messages, which are T
/// to it: TypedCode, CodeByTable of generic.hpp, or those of service_message.hpp.
template <class T, class Code>
class Lender {
 public:
  using Owner = typename Code::Owner;  // a unique_ptr

  /// Sets a loan aside that will be filled later: from now on the thread that borrowed it allocates
  /// as if it had not; LoanScope(loan) goes on. The thing to do before another thread gets it to
  /// publish: that thread cannot end this one's scope, which then lasts to its next borrow. False if
  /// it was not lent here. Any thread, but not while another publishes the same loan.
  bool pause(const ipc_shared_ptr<T>& message) noexcept {
    Loan* const loan = loan_of(message);
    if (loan == nullptr || loan->message == nullptr) return false;
    loan->scope.close();
    return true;
  }

 protected:
  Lender(LenderId id, Code code) noexcept : id_(id.value()), code_(code) {}
  ~Lender() = default;

  ipc_shared_ptr<T> lend() const {
    auto loan = std::make_unique<Loan>(code_);
    loan->lender = id_;
    loan->end = [](Block* block) noexcept { delete static_cast<Loan*>(block); };
    loan->scope.open();
    loan->message = code_.make().release();
    return ipc_shared_ptr<T>(loan.release());
  }
  /// Gives what was lent to `commit_owned(Owner&&)`, which leaves it where it is unless it succeeds.
  template <class Commit>
  PublishResult take_back(ipc_shared_ptr<T>&& message, Commit&& commit_owned) const noexcept {
    Loan* const loan = loan_of(message);
    if (loan == nullptr) return {Errc::loan_invalid, 0};
    Owner object = code_.own(static_cast<T*>(take_message(*loan)));
    if (object == nullptr) return {Errc::loan_invalid, 0};
    const PublishResult result = commit_owned(std::move(object));
    if (result) {
      loan->scope.close();
      message.reset();
    } else {
      loan->message.store(object.release(), std::memory_order_release);
    }
    return result;
  }
  const Code& code() const noexcept { return code_; }

 private:
  struct Loan : Block {
    explicit Loan(const Code& of) noexcept : code(of) {}
    ~Loan() { (void)code.own(static_cast<T*>(message.load(std::memory_order_relaxed))); }
    Code code;
    BorrowScope scope;  // closed after the message is gone: member order
  };
  /// Of several copies of the handle one gets it. A single one is nobody's rival, and needs no locked
  /// instruction.
  static void* take_message(Loan& loan) noexcept {
    if (loan.users.load(std::memory_order_acquire) != 1)
      return loan.message.exchange(nullptr, std::memory_order_acq_rel);
    void* const message = loan.message.load(std::memory_order_relaxed);
    loan.message.store(nullptr, std::memory_order_relaxed);
    return message;
  }
  Loan* loan_of(const ipc_shared_ptr<T>& message) const noexcept {
    Block* const block = message.block();
    return block != nullptr && block->lender == id_ ? static_cast<Loan*>(block) : nullptr;
  }

  std::uint64_t id_;
  Code code_;
};

/// Loans and their commit, of typed and of generic publishers.
template <class T, class Code>
class LendingPublisher : public PublisherBase, public Lender<T, Code> {
 public:
  using typename Lender<T, Code>::Owner;

  /// Commits a loan of this publisher; every copy of the handle becomes empty, in other threads too.
  /// Who published through one copy has published for all: publishing another copy, also at the same
  /// time, is loan_invalid. A thread that still writes to the message then writes to what
  /// subscriptions read. On failure `message` is as before, though an adopted message has moved.
  PublishResult publish(ipc_shared_ptr<T>&& message) noexcept {
    return this->take_back(std::move(message),
                           [this](Owner&& object) { return publish(std::move(object)); });
  }

  /// Commits a message that was made anywhere. What of it lies outside the shared heap is adopted.
  /// On failure `message` is as before.
  PublishResult publish(Owner&& message) noexcept {
    return commit(untyped(), this->code(), std::move(message));
  }

  /// publish for keep-all: while a subscription has not read enough (would_block), waits for it, at
  /// most `timeout`; one attempt at least. Nobody rings a publisher, so this asks again and again: 10
  /// µs after the first refusal, then ever more rarely, every millisecond in the end. So a wait of
  /// long standing costs a thousand short looks a second, and ends up to a millisecond late.
  template <class Message, class Rep, class Period>
  PublishResult publish_for(Message&& message,
                            std::chrono::duration<Rep, Period> timeout) noexcept {
    static_assert(!std::is_lvalue_reference_v<Message>, "publish_for(std::move(message), timeout)");
    Patience patience(timeout);
    std::uint64_t adopted_bytes = 0;
    for (;;) {
      PublishResult result = publish(std::move(message));
      result.adopted_bytes = adopted_bytes += result.adopted_bytes;
      if (result.code != Errc::would_block || !patience.wait()) return result;
    }
  }

  /// The same as publish, for callers that must look at the result.
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

  /// A copy in the shared heap; without a message, `code` says why.
  struct Copied {
    Owner message;
    std::uint64_t bytes = 0;
    Errc code = Errc::ok;
  };
  template <class Object>
  Copied copy_in(const Object& message) noexcept {
    return copy_in(this->code(), message);
  }
  template <class CopyCode, class Object>
  Copied copy_in(const CopyCode& code, const Object& message) noexcept {
    UntypedPublisher& publisher = untyped();
    if (const Errc state = publisher.state(); state != Errc::ok) return {nullptr, 0, state};
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
  PublishResult publish_copy(Copied&& copy) noexcept {
    if (copy.message == nullptr) return {copy.code, 0};
    if (const Errc state = untyped().state(); state != Errc::ok) return {state, copy.bytes};
    return {commit_resident(untyped(), this->code(), copy.message, copy.bytes), copy.bytes};
  }

  // Hides that of Lender, which clients and services use: what those leave goes by their next publish.
  ipc_shared_ptr<T> lend() {
    untyped().make_room();
    return Lender<T, Code>::lend();
  }
};

/// Copies messages of a publisher that may lie, of a type with a table. `is_whole` becomes false of one that leads
/// out of `windows`; the copy is then of no use.
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

/// Any thread may call anything; publishes of one publisher are ordered by a private mutex.
template <class T>
class Publisher : public detail::LendingPublisher<T, detail::TypedCode<T>> {
  using Base = detail::LendingPublisher<T, detail::TypedCode<T>>;

 public:
  using SharedPtr = std::shared_ptr<Publisher>;

  /// For create_publisher.
  explicit Publisher(std::shared_ptr<detail::UntypedPublisher> untyped) noexcept
      : Base(std::move(untyped)) {}

  /// A message to fill. From here to publish (or its destruction) this thread allocates from the
  /// shared heap; many loans at once are fine, and LoanScope takes one to other threads. If the heap
  /// is full the memory comes from libc and publish says heap_exhausted. Like publish it destroys old
  /// messages: hold no lock that a destructor of theirs wants. Throws what T's constructor throws, and
  /// std::bad_alloc.
  ipc_shared_ptr<T> borrow_loaned_message() {
    static_assert(std::is_default_constructible_v<T>,
                  "agnocast: this message has no default constructor, so it cannot be borrowed; "
                  "publish a std::unique_ptr of it");
    return this->lend();
  }

  using Base::publish;
  /// Publishes a copy, which is made in the shared heap: for code that has a message of its own, or passes on
  /// one that it has received. `adopted_bytes` is all of it; a loan or a std::unique_ptr costs less. Errors as
  /// of the others, but for loan_invalid; and protocol_violation: a received message of rosidl's leads out of
  /// the memory of its publisher (docs/messages.md, Forwarding).
  PublishResult publish(const T& message) noexcept {
    return this->publish_copy(copy_of(message));
  }
  using Base::try_publish;
  [[nodiscard]] PublishResult try_publish(const T& message) noexcept { return publish(message); }
  /// publish_for of a message of the caller's: one copy, however often it is tried.
  template <class Rep, class Period>
  PublishResult publish_for(const T& message, std::chrono::duration<Rep, Period> timeout) noexcept {
    detail::Patience patience(timeout);
    auto copy = copy_of(message);
    for (;;) {
      const PublishResult result = this->publish_copy(std::move(copy));
      if (result.code != Errc::would_block || !patience.wait()) return result;
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
      if (windows.count() != 0) [[unlikely]] {
        bool is_whole = true;
        auto copy = this->copy_in(detail::CheckedCode<T>(windows, is_whole), message);
        if (!is_whole) copy = {nullptr, 0, Errc::protocol_violation};
        return copy;
      }
    }
    return this->copy_in(message);
  }
};

/// A publisher, or why there is none. Errors: daemon_not_running, hook_missing, hook_ineffective,
/// invalid_name, type_mismatch, type_refused, depth_refused, quota_exceeded, access_denied, …
/// (include/agnocast/error.hpp).
template <class T, class Node>
[[nodiscard]] Result<typename Publisher<T>::SharedPtr> try_create_publisher(
    Node&& node, const std::string& topic, const QoS& qos, const PublisherOptions& options = {}) {
  Result<detail::EndpointName> name = detail::resolve(detail::dereference(node), topic);
  if (!name) return tl::unexpected<Failure>(name.error());
  Result<MessageType> type = message_type_of<T>();
  if (!type) return tl::unexpected<Failure>(type.error());
  auto untyped = detail::UntypedPublisher::create(
      *name, std::move(*type), qos, options,
      detail::MessageCode{detail::MessageEnd::of<T>(), std::is_base_of_v<SharedMessage, T>});
  if (!untyped) return tl::unexpected<Failure>(untyped.error());
  return std::make_shared<Publisher<T>>(std::move(*untyped));
}

/// The same; throws agnocast::Error.
template <class T, class Node>
typename Publisher<T>::SharedPtr create_publisher(Node&& node, const std::string& topic,
                                                  const QoS& qos,
                                                  const PublisherOptions& options = {}) {
  auto publisher = try_create_publisher<T>(node, topic, qos, options);
  if (!publisher) detail::throw_error(publisher.error());
  return std::move(*publisher);
}

}  // namespace agnocast
