// SPDX-License-Identifier: Apache-2.0

#include <ros2/rmw_agnocast_cpp/core/topics.hpp>

#include <agnocast/relay.hpp>

#include <algorithm>
#include <array>
#include <chrono>
#include <exception>
#include <new>
#include <thread>

namespace agnocast::rmw {
namespace {

// How long a reliable keep-all subscription that does not read holds up a publisher of its kind:
// max_blocking_time of a DDS writer (DDS 1.4, 2.2.3.14).
constexpr std::chrono::milliseconds blocking_time{100};

// A publisher may publish malformed messages without end; a take drops so many of them.
constexpr int dropped_max = 64;

// Endpoints of this process are linked by its threads, within a millisecond; under load it may take
// longer, and then messages come as those of other processes.
constexpr std::chrono::milliseconds own_link_time{100};

/// Waits until the publishers of this process have linked with its subscriptions to the topic.
void link_own_publishers(OwnDomain domain, const std::string& topic) {
  using Clock = std::chrono::steady_clock;
  const auto end = Clock::now() + own_link_time;  // for all of them
  std::chrono::microseconds pause{50};
  for (;;) {
    bool are_linked = true;
    OwnEndpoint<const GenericPublisher*>::visit(
        domain, topic, [&](const GenericPublisher* publisher) {
          are_linked = are_linked && publisher->wait_for_local_links(std::chrono::nanoseconds(0));
        });
    const auto left = end - Clock::now();
    if (are_linked || left <= left.zero()) return;
    std::this_thread::sleep_for(std::min<Clock::duration>(left, pause));
    pause = std::min<std::chrono::microseconds>(2 * pause, std::chrono::milliseconds(1));
  }
}

}  // namespace

Result<std::unique_ptr<TopicPublisher>> TopicPublisher::create(const NodeName& node,
                                                               const std::string& topic,
                                                               const MessageSupport& support,
                                                               const QoS& qos) {
  auto publisher = try_create_generic_publisher(node, topic, support.type(), qos);
  if (!publisher) return tl::unexpected<Failure>(publisher.error());
  std::unique_ptr<TopicPublisher> made(new TopicPublisher(support, *publisher, node.domain, topic));
  (void)made->endpoint().wait_for_local_links(own_link_time);
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
  link_own_publishers(node.domain, topic);
  return made;
}

bool TopicSubscription::take(void* message, MessageInfo& info) {
  for (int dropped = 0; dropped < dropped_max; ++dropped) {
    const GenericMessage taken = subscription_->take();
    if (!taken) return false;
    const WindowSet windows = windows_of(taken);
    if (!support_.to_node(taken.get(), message, windows)) continue;
    info = taken.info();
    return true;
  }
  return false;
}

bool TopicSubscription::take_serialized(std::vector<std::byte>& bytes, MessageInfo& info) {
  for (int dropped = 0; dropped < dropped_max; ++dropped) {
    const GenericMessage taken = subscription_->take();
    if (!taken) return false;
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
