// SPDX-License-Identifier: Apache-2.0

#include <ros2/rmw_agnocast_cpp/core/topics.hpp>

#include <agnocast/relay.hpp>

#include <array>
#include <chrono>
#include <exception>
#include <new>

namespace agnocast::rmw {
namespace {

// How long a reliable keep-all subscription that does not read holds up a publisher of its kind:
// max_blocking_time of a DDS writer (DDS 1.4, 2.2.3.14).
constexpr std::chrono::milliseconds blocking_time{100};

/// Lets the publishers of this process link with its subscriptions, which its threads do within a
/// millisecond; under load it may take longer, and then messages come as those of other processes.
void link_own(const std::string& topic) {
  using Clock = std::chrono::steady_clock;
  const auto end = Clock::now() + std::chrono::milliseconds(100);  // for all of them
  for (const auto& own : OwnEndpoint<std::weak_ptr<GenericPublisher>>::all_of(topic)) {
    const auto publisher = own.lock();
    if (publisher != nullptr && !publisher->wait_for_local_links(end - Clock::now())) return;
  }
}

}  // namespace

Result<std::unique_ptr<TopicPublisher>> TopicPublisher::create(const NodeName& node,
                                                               const std::string& topic,
                                                               const MessageSupport& support,
                                                               const QoS& qos) {
  auto publisher = try_create_generic_publisher(node, topic, support.type(), qos);
  if (!publisher) return tl::unexpected<Failure>(publisher.error());
  std::unique_ptr<TopicPublisher> made(new TopicPublisher(support, *publisher, topic));
  link_own(topic);
  return made;
}

PublishResult TopicPublisher::publish(const void* message) noexcept {
  if (support_.c_layout() == nullptr) return publisher_->publish_copy_of(message, blocking_time);
  try {
    GenericLoan loan = publisher_->borrow_loaned_message();
    if (!support_.c_layout()->to_cpp(message, loan.get())) return {Errc::invalid_argument, 0};
    return publisher_->publish_for(std::move(loan.handle()), blocking_time);
  } catch (const std::bad_alloc&) {
    return {Errc::heap_exhausted, 0};
  } catch (const std::exception&) {
    return {Errc::invalid_argument, 0};  // a sequence longer than any memory
  }
}

PublishResult TopicPublisher::publish_serialized(std::span<const std::byte> bytes) noexcept {
  try {
    GenericLoan loan = publisher_->borrow_loaned_message();
    const std::array pieces{bytes};
    if (!bridge::read_cdr(support_.cdr(), pieces, loan.get())) return {Errc::invalid_argument, 0};
    return publisher_->publish_for(std::move(loan.handle()), blocking_time);
  } catch (const std::bad_alloc&) {
    return {Errc::heap_exhausted, 0};
  } catch (const std::exception&) {
    return {Errc::invalid_argument, 0};  // a sequence longer than any memory
  }
}

void* TopicPublisher::borrow() { return loans_.add<void*>(publisher_->borrow_loaned_message()); }

PublishResult TopicPublisher::publish_loaned(void* message) noexcept {
  GenericLoan loan = loans_.take(message);
  if (!loan) return {Errc::loan_invalid, 0};
  return publisher_->publish_for(std::move(loan.handle()), blocking_time);
}

Result<std::unique_ptr<TopicSubscription>> TopicSubscription::create(
    const NodeName& node, const std::string& topic, const MessageSupport& support, const QoS& qos,
    bool ignores_local_publications) {
  SubscriptionOptions options;
  options.ignore_local_publications(ignores_local_publications);
  auto subscription =
      try_create_generic_subscription(node, topic, support.type(), qos, nullptr, options);
  if (!subscription) return tl::unexpected<Failure>(subscription.error());
  std::unique_ptr<TopicSubscription> made(new TopicSubscription(support, std::move(*subscription)));
  link_own(topic);
  return made;
}

bool TopicSubscription::take(void* message, MessageInfo& info) {
  while (const GenericMessage taken = subscription_->take()) {
    const WindowSet windows = windows_of(taken);
    if (!support_.to_node(taken.get(), message, windows)) continue;
    info = taken.info();
    return true;
  }
  return false;
}

bool TopicSubscription::take_serialized(std::vector<std::byte>& bytes, MessageInfo& info) {
  while (const GenericMessage taken = subscription_->take()) {
    const WindowSet windows = windows_of(taken);
    const std::size_t count = bridge::cdr_bytes(support_.cdr(), taken.get(), &windows);
    bytes.resize(count);
    if (count == 0 || !bridge::write_cdr(support_.cdr(), taken.get(), bytes, &windows)) continue;
    info = taken.info();
    return true;
  }
  return false;
}

const void* TopicSubscription::take_loaned(MessageInfo& info) {
  GenericMessage taken = subscription_->take();
  if (!taken) return nullptr;
  info = taken.info();
  return loans_.add<const void*>(std::move(taken));
}

}  // namespace agnocast::rmw
