// SPDX-License-Identifier: Apache-2.0
//
// The untyped half of Subscription and ipc_shared_ptr, called by their templates.

#include <agnocast/message_windows.hpp>
#include <agnocast/subscription.hpp>
#include <base/clock.hpp>
#include <client/api/qos_words.hpp>
#include <client/executors/callback_groups.hpp>
#include <client/heap/address_users.hpp>
#include <client/process/forked_child.hpp>
#include <client/session/context.hpp>

#include <time.h>

#include <memory>
#include <new>
#include <utility>

namespace agnocast {
namespace {

std::uint64_t realtime_ns() noexcept {
  timespec now{};
  ::clock_gettime(CLOCK_REALTIME, &now);
  return static_cast<std::uint64_t>(now.tv_sec) * 1'000'000'000 +
         static_cast<std::uint64_t>(now.tv_nsec);
}

}  // namespace

// A thread that is put off its processor between two reads gets a wrong offset.
std::uint64_t MessageInfo::source_timestamp() const noexcept {
  constexpr std::uint64_t apart_max_ns = 10'000;
  constexpr int tries_max = 8;
  std::uint64_t offset = 0, apart = UINT64_MAX;
  for (int i = 0; i < tries_max && apart > apart_max_ns; ++i) {
    const std::uint64_t before = monotonic_ns();
    const std::uint64_t real = realtime_ns();
    const std::uint64_t took = monotonic_ns() - before;
    if (took >= apart) continue;
    apart = took;
    offset = real - before - took / 2;
  }
  return offset + publish_time_ns;
}

namespace {

// Called by the last user.
void end_block(detail::Block* last) noexcept {
  auto* const own = static_cast<ReceivedBlock*>(last);
  const Received received = std::move(own->received);
  own->users.store(1, std::memory_order_relaxed);
  received.release();
  received.link->keep(own);
}

}  // namespace

namespace detail {

WindowSet windows_of(const Block* block) noexcept {
  if (block == nullptr || block->end != end_block) return {};
  const auto& received = static_cast<const ReceivedBlock*>(block)->received;
  return received.link->peer().heap().window_set_of(received.taken.address);
}

WindowSet windows_of_another(const void* object) noexcept {
  const auto address = reinterpret_cast<std::uintptr_t>(object);
  AddressUsers& users = AddressUsers::instance();
  // In a forked child its lock may be held for ever.
  if (!users.may_be_of_another(address) || is_forked_child()) return {};
  return users.window_set_of_another(address);
}

}  // namespace detail

namespace {

// Received messages, chained in order.
class BlockReceiver final : public Receiver {
 public:
  explicit BlockReceiver(std::size_t wanted) noexcept : Receiver(wanted) {}
  BlockReceiver(const BlockReceiver&) = delete;
  BlockReceiver& operator=(const BlockReceiver&) = delete;
  ~BlockReceiver() { delete block_; }
  Received* place(Link& link) noexcept override {
    finish_last();
    if (block_ == nullptr) block_ = static_cast<ReceivedBlock*>(link.spare());
    if (block_ == nullptr) block_ = new (std::nothrow) ReceivedBlock;
    return block_ != nullptr ? &block_->received : nullptr;
  }
  detail::Block* take_out() noexcept {
    finish_last();
    return chain_;
  }

 private:
  void finish_last() noexcept {
    if (block_ == nullptr || block_->received.link == nullptr) return;
    const dataplane::Taken& taken = block_->received.taken;
    const Link& link = *block_->received.link;
    block_->message.store(reinterpret_cast<void*>(taken.address), std::memory_order_relaxed);
    block_->end = end_block;
    block_->info.sequence = taken.sequence - link.first_sequence();
    block_->info.publisher = link.generation();
    block_->info.publish_time_ns = taken.stamp_ns;
    block_->info.object_bytes = taken.size;
    *end_ = block_;
    end_ = &block_->next;
    block_ = nullptr;
  }

  ReceivedBlock* block_ = nullptr;  // placed last
  detail::Block* chain_ = nullptr;
  detail::Block** end_ = &chain_;
};

/// Takes up to `wanted` (not 0) messages as a chain of Blocks; null if there is none (or no
/// memory for it: then it stays unread).
detail::Block* take_blocks(SubscriptionEndpoint& subscription, std::size_t wanted) noexcept {
  BlockReceiver receiver(wanted);
  return subscription.take(receiver) ? receiver.take_out() : nullptr;
}

class SubscriptionSource final : public CallbackSource {
 public:
  SubscriptionSource(std::shared_ptr<SubscriptionEndpoint> endpoint,
                     detail::UntypedSubscription::Callback callback,
                     const SubscriptionOptions& options)
      : CallbackSource(options.is_serial()),
        endpoint_(std::move(endpoint)),
        callback_(std::move(callback)),
        events_(options.events()) {}
  ~SubscriptionSource() override {
    const UserSignals as_creator(signals);
    callback_ = nullptr;
    events_ = {};
  }

  bool has_work() const noexcept override {
    return endpoint_->events().has_pending() || (callback_ != nullptr && endpoint_->has_news()) ||
           is_look_due();
  }
  Clock::time_point due() const noexcept override {
    return reports_times_ ? endpoint_->events().look_due() : Clock::time_point::max();
  }
  bool run_one() override {
    if (is_look_due()) endpoint_->look_at_times();
    if (endpoint_->events().run_one(events_)) return true;
    if (callback_ == nullptr) return false;
    detail::Block* const block = take_blocks(*endpoint_, 1);
    if (block == nullptr) return false;
    callback_(block);
    return true;
  }

 private:
  bool is_look_due() const noexcept { return reports_times_ && due() <= Clock::now(); }

  const std::shared_ptr<SubscriptionEndpoint> endpoint_;
  detail::UntypedSubscription::Callback callback_;
  detail::EventCallbacks events_;
  const bool reports_times_ = events_.deadline != nullptr || events_.liveliness_changed != nullptr;
};

}  // namespace

namespace detail {

Result<std::shared_ptr<UntypedSubscription>> UntypedSubscription::create(
    const EndpointName& name, const MessageType& type, const QoS& qos,
    const SubscriptionOptions& options, Callback callback) {
  if (Result<void> fits = check_qos(qos); !fits) return tl::unexpected<Failure>(fits.error());
  if (options.hold_quota() == 0)
    return fail(Errc::invalid_argument, "with a hold quota of 0 nothing can be taken");
  // Best available: best effort, which matches every publisher.
  QoS requested = qos;
  if (qos.is_best_available()) requested.best_effort();
  requested.lifespan(std::chrono::nanoseconds(0));
  std::shared_ptr<UntypedSubscription> subscription(new UntypedSubscription(name.topic, requested));
  const Result<bool> off = is_switched_off();
  if (!off) return tl::unexpected<Failure>(off.error());
  if (*off) return subscription;
  std::shared_ptr<WaitSet> wait_set;
  if (callback || options.events()) {
    auto group = callback_groups::of_endpoint(name.node, options.callback_group());
    if (!group) return tl::unexpected<Failure>(group.error());
    subscription->group_ = std::move(*group);
    wait_set = subscription->group_->state().callbacks->wait_set();
  }
  if (!callback) {
    auto idle = Context::instance().idle_wait_set();
    if (!idle) return tl::unexpected<Failure>(idle.error());
    wait_set = std::move(*idle);
  }
  EndpointRequest request;
  request.topic = name.topic;
  request.node = name.node;
  request.domain = name.domain;
  request.type = type.name();
  request.layout_hash = type.layout_hash();
  request.qos = to_abi(requested);
  request.qos.ignore_local = options.ignores_local_publications();
  request.quota = options.hold_quota();
  request.quota_or_less = !options.is_hold_quota_set();
  request.depth_per_publisher = options.is_depth_per_publisher();
  request.persistent_id = name.persistent_id;
  request.message_bytes = type.message_bytes();
  request.message_alignment = type.message_alignment();
  auto endpoint = Context::instance().create_subscription(request, std::move(wait_set));
  if (!endpoint) return tl::unexpected<Failure>(endpoint.error());
  subscription->endpoint_ = std::move(*endpoint);
  if (subscription->group_ != nullptr) {
    GroupCallbacks& callbacks = *subscription->group_->state().callbacks;
    subscription->endpoint_->events().wake_for(options.events(), callbacks.wait_set());
    subscription->source_ =
        std::make_shared<SubscriptionSource>(subscription->endpoint_, std::move(callback), options);
    callbacks.add(subscription->source_);
  }
  return subscription;
}

UntypedSubscription::~UntypedSubscription() { end(); }

void UntypedSubscription::end(std::chrono::steady_clock::time_point end) noexcept {
  if (endpoint_ == nullptr || std::exchange(has_ended_, true)) return;
  if (source_ != nullptr) group_->state().callbacks->remove(*source_, group_);
  Context::instance().destroy(endpoint_, end);
}

bool UntypedSubscription::is_own() const noexcept { return is_served(); }
bool UntypedSubscription::is_active() const noexcept {
  return endpoint_ != nullptr && !is_revoked();
}
Block* UntypedSubscription::take(std::size_t count) noexcept {
  return endpoint_ != nullptr && count != 0 ? take_blocks(*endpoint_, count) : nullptr;
}
bool UntypedSubscription::has_unread() const noexcept {
  return endpoint_ != nullptr && endpoint_->has_news();
}
Arrivals UntypedSubscription::arrivals() noexcept {
  return endpoint_ != nullptr ? endpoint_->arrivals() : Arrivals{};
}
std::uint64_t UntypedSubscription::lost() const noexcept {
  return endpoint_ != nullptr ? endpoint_->lost() : 0;
}
std::size_t UntypedSubscription::publisher_count() const noexcept {
  return endpoint_ != nullptr ? endpoint_->publisher_count() : 0;
}
std::size_t UntypedSubscription::linked_publisher_count() const noexcept {
  return endpoint_ != nullptr ? endpoint_->publisher_count(true) : 0;
}
std::uint64_t UntypedSubscription::callback_exception_count() const noexcept {
  return source_ != nullptr ? source_->exception_count.load(std::memory_order_relaxed) : 0;
}
std::uint64_t UntypedSubscription::persistent_id() const noexcept {
  return endpoint_ != nullptr ? endpoint_->identity().persistent_id : 0;
}
std::vector<UntypedSubscription::Writer> UntypedSubscription::writers() const {
  std::vector<Writer> all;
  if (endpoint_ != nullptr)
    endpoint_->for_each_writer([&](std::uint64_t persistent_id, bool is_gone) {
      all.push_back({persistent_id, is_gone});
    });
  return all;
}
void UntypedSubscription::look_again() noexcept {
  if (endpoint_ != nullptr) endpoint_->events().publisher_exhausted();
}
void UntypedSubscription::tell(std::shared_ptr<Watch> watch) noexcept {
  if (endpoint_ != nullptr) endpoint_->events().tell(std::move(watch));
}
MatchedInfo UntypedSubscription::matched_status() noexcept {
  return endpoint_ != nullptr ? endpoint_->events().matched_status() : MatchedInfo{};
}
std::chrono::steady_clock::time_point UntypedSubscription::event_due() const noexcept {
  return endpoint_ != nullptr ? endpoint_->events().look_due()
                              : std::chrono::steady_clock::time_point::max();
}
DeadlineMissedInfo UntypedSubscription::deadline_missed_status() noexcept {
  if (endpoint_ == nullptr) return {};
  endpoint_->look_at_times();
  return endpoint_->events().deadline_missed_status();
}
LivelinessChangedInfo UntypedSubscription::liveliness_changed_status() noexcept {
  if (endpoint_ == nullptr) return {};
  endpoint_->look_at_times();
  return endpoint_->events().liveliness_changed_status();
}
IncompatibleQosInfo UntypedSubscription::incompatible_qos_status() noexcept {
  return endpoint_ != nullptr ? endpoint_->events().incompatible_qos_status()
                              : IncompatibleQosInfo{};
}
HoldQuotaInfo UntypedSubscription::hold_quota_status() noexcept {
  return endpoint_ != nullptr ? endpoint_->events().hold_quota_status() : HoldQuotaInfo{};
}
HeapCollisionInfo UntypedSubscription::heap_collision_status() noexcept {
  return endpoint_ != nullptr ? endpoint_->events().heap_collision_status() : HeapCollisionInfo{};
}

IncompatibleTypeInfo UntypedSubscription::incompatible_type_status() noexcept {
  return endpoint_ != nullptr ? endpoint_->events().incompatible_type_status()
                              : IncompatibleTypeInfo{};
}

}  // namespace detail
}  // namespace agnocast
