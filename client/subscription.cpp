// SPDX-License-Identifier: Apache-2.0
//
// The untyped half of Subscription and ipc_shared_ptr: what their templates call.

#include <agnocast/subscription.hpp>
#include <client/context.hpp>
#include <client/qos_words.hpp>
#include <client/runner.hpp>

#include <time.h>

#include <utility>

namespace agnocast {
namespace {

std::uint64_t now_ns(clockid_t clock) noexcept {
  timespec now{};
  ::clock_gettime(clock, &now);
  return static_cast<std::uint64_t>(now.tv_sec) * 1'000'000'000 +
         static_cast<std::uint64_t>(now.tv_nsec);
}

}  // namespace

std::uint64_t MessageInfo::source_timestamp() const noexcept {
  return now_ns(CLOCK_REALTIME) - now_ns(CLOCK_MONOTONIC) + publish_time_ns;
}

namespace detail {

Result<std::shared_ptr<UntypedSubscription>> UntypedSubscription::create(
    const EndpointName& name, const MessageType& type, const QoS& qos,
    const SubscriptionOptions& options, Callback callback) {
  if (Result<void> depth = check_depth(qos); !depth) return tl::unexpected<Failure>(depth.error());
  std::shared_ptr<UntypedSubscription> subscription(new UntypedSubscription);
  subscription->topic_ = name.topic;
  std::shared_ptr<Sleeper> sleeper;
  if (callback) {
    auto runner = Runner::of_node(name.node);
    if (!runner) return tl::unexpected<Failure>(runner.error());
    subscription->runner_ = std::move(*runner);
    sleeper = subscription->runner_->sleeper();
  } else {
    auto idle = Context::instance().idle_sleeper();
    if (!idle) return tl::unexpected<Failure>(idle.error());
    sleeper = std::move(*idle);
  }
  EndpointRequest request;
  request.topic = name.topic;
  request.node = name.node;
  request.type = type.name();
  request.layout_hash = type.layout_hash();
  request.qos = to_abi(qos);
  request.quota = options.hold_quota();
  request.message_bytes = type.message_bytes();
  request.message_alignment = type.message_alignment();
  auto endpoint = Context::instance().create_subscription(request, std::move(sleeper));
  if (!endpoint) return tl::unexpected<Failure>(endpoint.error());
  subscription->endpoint_ = std::move(*endpoint);
  if (callback) subscription->runner_->add(subscription->endpoint_, std::move(callback));
  return subscription;
}

UntypedSubscription::~UntypedSubscription() {
  if (endpoint_ == nullptr) return;
  if (runner_ != nullptr) runner_->remove(*endpoint_);
  Context::instance().destroy(endpoint_);
}

Block* UntypedSubscription::take() noexcept { return take_block(*endpoint_); }
std::uint64_t UntypedSubscription::lost() const noexcept { return endpoint_->lost(); }
std::size_t UntypedSubscription::publisher_count() const noexcept {
  return endpoint_->publisher_count();
}

}  // namespace detail
}  // namespace agnocast
