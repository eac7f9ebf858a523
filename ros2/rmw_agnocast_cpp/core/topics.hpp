// SPDX-License-Identifier: Apache-2.0
//
// TopicPublisher and TopicSubscription: the endpoints of an rmw. Messages come and go in the node's
// own layout, as CDR, or as loans.
//
//   publish             node's message ── copy ──▶ shared memory      (C, no heap hook: two copies)
//   publish_loaned      nothing is copied with the heap hook
//   take                shared memory ── copy, checked ──▶ node's message
//   take_loaned         nothing is copied; the message is read-only
//
// Any thread may call any function.
#pragma once

#include <agnocast/generic.hpp>
#include <agnocast/heap.hpp>
#include <agnocast/qos.hpp>
#include <agnocast/result.hpp>
#include <ros2/rmw_agnocast_cpp/core/events.hpp>
#include <ros2/rmw_agnocast_cpp/core/listener.hpp>
#include <ros2/rmw_agnocast_cpp/core/message_support.hpp>
#include <ros2/rmw_agnocast_cpp/core/own_endpoints.hpp>

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

namespace agnocast::rmw {

/// A node's place in the graph. rcl has applied remappings already.
struct NodeName {
  std::string name;
  std::string name_space;                    // "/" or "/a/b"
  std::optional<std::uint64_t> domain = {};  // none: that of the process

  const char* get_name() const noexcept { return name.c_str(); }
  const char* get_namespace() const noexcept { return name_space.c_str(); }
  std::optional<std::uint64_t> get_domain_id() const noexcept { return domain; }
  std::string get_fully_qualified_name() const {
    return (name_space == "/" ? "" : name_space) + "/" + name;
  }
};

/// Loans that the node has: by the address of the message. Any thread.
template <class Loan>
class Loans {
 public:
  /// Keeps it and returns its address. Throws std::bad_alloc.
  template <class Address>
  Address add(Loan loan) {
    const LoanPause pause;  // the table is private memory
    const Address address = loan.get();
    const std::lock_guard lock(mutex_);
    loans_.emplace(address, std::move(loan));
    return address;
  }
  /// Returns the loan, or an empty one if there is none of this address.
  Loan take(const void* address) noexcept {
    const std::lock_guard lock(mutex_);
    const auto found = loans_.find(address);
    if (found == loans_.end()) return {};
    Loan loan = std::move(found->second);
    loans_.erase(found);
    return loan;
  }

 private:
  std::mutex mutex_;
  std::unordered_map<const void*, Loan> loans_;
};

/// As in DDS, a message that is published when the creation of both endpoints has returned can be
/// taken at once, if both are of this process.
class TopicPublisher {
 public:
  /// Errors: as of create_publisher. Throws std::bad_alloc.
  [[nodiscard]] static Result<std::unique_ptr<TopicPublisher>> create(const NodeName& node,
                                                                      const std::string& topic,
                                                                      const MessageSupport& support,
                                                                      const QoS& qos);

  /// These publish, and wait for a keep-all subscription as long as a DDS writer does (100 ms)
  /// before they return would_block.
  ///
  /// Publishes a copy of the node's message. Errors: those of PublishResult; invalid_argument: a
  /// member is longer than its type allows.
  [[nodiscard]] PublishResult publish(const void* message) noexcept;
  /// Publishes what these bytes say, with their encapsulation. Errors: also invalid_argument: they
  /// are no such message.
  [[nodiscard]] PublishResult publish_serialized(std::span<const std::byte> bytes) noexcept;

  /// Returns whether messages can be borrowed: those of a node in C++.
  bool can_lend() const noexcept { return support_.c_layout() == nullptr; }
  /// Lends a default message to fill; see Publisher::borrow_loaned_message. Only where can_lend().
  /// Throws std::bad_alloc.
  void* borrow();
  /// Ends a loan: publishes it, also if that fails, or gives it back. Errors: loan_invalid: it is
  /// none.
  [[nodiscard]] PublishResult publish_loaned(void* message) noexcept;
  bool give_back(void* message) noexcept { return static_cast<bool>(loans_.take(message)); }

  GenericPublisher& endpoint() const noexcept { return *publisher_; }
  PublisherEvents& events() noexcept { return events_; }
  /// What a Listener has to forget before this ends.
  std::array<Listenable*, 3> listenables() noexcept { return events_.all(); }
  const MessageSupport& support() const noexcept { return support_; }

 private:
  TopicPublisher(MessageSupport support, const GenericPublisher::SharedPtr& publisher,
                 OwnDomain domain, const std::string& topic)
      : support_(std::move(support)),
        publisher_(publisher),
        own_(domain, topic, publisher.get()),
        events_(*publisher_) {}

  const MessageSupport support_;
  const GenericPublisher::SharedPtr publisher_;
  const OwnEndpoint<const GenericPublisher*> own_;  // ends before what it points to
  PublisherEvents events_;
  Loans<GenericLoan> loans_;
};

class TopicSubscription final : public Listenable {
 public:
  /// Errors: as of create_subscription. Throws std::bad_alloc.
  [[nodiscard]] static Result<std::unique_ptr<TopicSubscription>> create(
      const NodeName& node, const std::string& topic, const MessageSupport& support, const QoS& qos,
      bool ignores_local_publications);

  bool is_ready() const noexcept override { return subscription_->has_unread(); }
  Arrivals arrivals() const noexcept override { return subscription_->get_arrivals(); }

  /// Takes the oldest message into the node's. Returns false, and leaves it, if there is none. A
  /// message that leads out of its publisher's memory is dropped, 64 at most by one call, and may
  /// leave some of its members there; the next one replaces them. Throws std::bad_alloc, then the
  /// message is lost.
  bool take(void* message, MessageInfo& info);
  /// The same as bytes with their encapsulation.
  bool take_serialized(std::vector<std::byte>& bytes, MessageInfo& info);

  /// Returns whether messages can be taken as they are: by a node in C++.
  bool can_lend() const noexcept { return support_.c_layout() == nullptr; }
  /// Takes the oldest message as it is: read-only memory of its publisher, which is trusted then;
  /// null: none. Only where can_lend(). Throws std::bad_alloc.
  const void* take_loaned(MessageInfo& info);
  /// Ends a loan; returns false if it is none.
  bool give_back(const void* message) noexcept { return static_cast<bool>(loans_.take(message)); }

  GenericSubscription& endpoint() const noexcept { return *subscription_; }
  SubscriptionEvents& events() noexcept { return events_; }
  std::array<Listenable*, 5> listenables() noexcept {
    const auto [a, b, c, d] = events_.all();
    return {this, a, b, c, d};
  }

 private:
  TopicSubscription(MessageSupport support, GenericSubscription::SharedPtr subscription) noexcept
      : support_(std::move(support)),
        subscription_(std::move(subscription)),
        events_(*subscription_) {}

  const MessageSupport support_;
  const GenericSubscription::SharedPtr subscription_;
  SubscriptionEvents events_;
  Loans<GenericMessage> loans_;
};

}  // namespace agnocast::rmw
