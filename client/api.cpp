// SPDX-License-Identifier: Apache-2.0
//
// The public interface's untyped half: what the templates in include/agnocast call.

#include <agnocast/publisher.hpp>
#include <agnocast/subscription.hpp>
#include <base/names.hpp>
#include <client/context.hpp>
#include <client/runner.hpp>

#include <time.h>

#include <atomic>
#include <utility>

namespace agnocast {
namespace {

std::uint64_t now_ns(clockid_t clock) noexcept {
  timespec now{};
  ::clock_gettime(clock, &now);
  return static_cast<std::uint64_t>(now.tv_sec) * 1'000'000'000 +
         static_cast<std::uint64_t>(now.tv_nsec);
}

abi::Qos to_abi(const QoS& qos) noexcept {
  return {static_cast<std::uint32_t>(qos.depth()), qos.is_transient_local(), qos.is_reliable(),
          qos.is_keep_all(), false};
}

// The daemon's own limit may be lower; this one is what a queue can hold at all.
Result<void> check_depth(const QoS& qos) noexcept {
  if (qos.depth() == 0) return fail(Errc::depth_refused, "a history depth of 0");
  if (qos.depth() > abi::depth_max) return fail(Errc::depth_refused, "a history depth above 1000");
  return {};
}

}  // namespace

std::uint64_t MessageInfo::source_timestamp() const noexcept {
  return now_ns(CLOCK_REALTIME) - now_ns(CLOCK_MONOTONIC) + publish_time_ns;
}

namespace detail {

Result<std::string> expand_topic(const std::string& topic, const std::string& node_name,
                                 const std::string& node_namespace) {
  auto expanded = expand_topic_name(topic, node_name, node_namespace);
  if (!expanded) return fail(Errc::invalid_name, expanded.error().what);
  return std::move(*expanded);
}

Result<void> require_topic(const std::string& topic) {
  if (const auto problem = check_topic_name(topic)) return fail(Errc::invalid_name, problem->what);
  return {};
}

// --- loan scopes ---

/// One per thread that ever borrowed; outlives the thread as long as one of its loans does.
struct LoanScope::Home {
  std::atomic<std::uint64_t> owed{0};   // leaves that other threads could not do for it
  std::atomic<std::uint64_t> users{1};  // the thread, and its open loans

  void let_go() noexcept {
    if (users.fetch_sub(1, std::memory_order_acq_rel) == 1) delete this;
  }
  void pay(const SharedHeap& heap) noexcept {
    for (std::uint64_t n = owed.exchange(0, std::memory_order_acquire); n > 0; --n)
      heap.leave(heap.context);
  }
};

namespace {

template <class Home>
struct ThreadHome {
  Home* home = nullptr;
  ~ThreadHome() {
    if (home != nullptr) home->let_go();
  }
};

}  // namespace

void LoanScope::open() noexcept {
  static thread_local ThreadHome<Home> mine;
  if (mine.home == nullptr) mine.home = new (std::nothrow) Home;
  if (mine.home == nullptr)
    return;  // no memory: the loan is built on the ordinary heap and adopted at publish
  current() = mine.home;
  const SharedHeap heap = Context::instance().shared_heap();
  mine.home->pay(heap);
  mine.home->users.fetch_add(1, std::memory_order_relaxed);
  home_ = mine.home;
  heap.enter(heap.context);
}

LoanScope::Home*& LoanScope::current() noexcept {
  static thread_local Home* home = nullptr;
  return home;
}

void LoanScope::close() noexcept {
  Home* const home = std::exchange(home_, nullptr);
  if (home == nullptr) return;
  if (current() == home) {
    const SharedHeap heap = Context::instance().shared_heap();
    heap.leave(heap.context);
    home->pay(heap);
  } else {
    home->owed.fetch_add(1, std::memory_order_release);
  }
  home->let_go();
}

// --- publisher ---

Result<std::shared_ptr<UntypedPublisher>> UntypedPublisher::create(
    const EndpointName& name, MessageType type, const QoS& qos, void (*destroy)(void*) noexcept) {
  if (Result<void> depth = check_depth(qos); !depth) return tl::unexpected<Failure>(depth.error());
  std::shared_ptr<UntypedPublisher> publisher(new UntypedPublisher(std::move(type), name.topic));
  EndpointRequest request;
  request.topic = name.topic;
  request.node = name.node;
  request.type = publisher->type_.name();
  request.layout_hash = publisher->type_.layout_hash();
  request.qos = to_abi(qos);
  auto endpoint = Context::instance().create_publisher(request, destroy);
  if (!endpoint) return tl::unexpected<Failure>(endpoint.error());
  publisher->endpoint_ = std::move(*endpoint);
  return publisher;
}

UntypedPublisher::~UntypedPublisher() {
  if (endpoint_ != nullptr) Context::instance().destroy(endpoint_);
}

Errc UntypedPublisher::publish(void* message, std::size_t bytes) noexcept {
  switch (endpoint_->publish(message, bytes)) {
    case dataplane::PublishOutcome::published:
      return Errc::ok;
    case dataplane::PublishOutcome::no_slot:
      return Errc::no_slot;
    case dataplane::PublishOutcome::would_block:
      return Errc::would_block;
  }
  return Errc::internal;
}

SharedHeap UntypedPublisher::heap() const noexcept { return Context::instance().shared_heap(); }
std::size_t UntypedPublisher::subscription_count() const noexcept {
  return endpoint_->subscription_count();
}

// --- subscription ---

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
