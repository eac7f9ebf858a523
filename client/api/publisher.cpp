// SPDX-License-Identifier: Apache-2.0
//
// The untyped half of Publisher, called by its template.

#include <agnocast/publisher.hpp>
#include <client/api/message_copy.hpp>
#include <client/api/qos_words.hpp>
#include <client/executors/callback_groups.hpp>
#include <client/heap/block_heap.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/steps.hpp>
#include <client/session/context.hpp>

#include <dlfcn.h>

#include <algorithm>
#include <chrono>
#include <thread>
#include <utility>

namespace agnocast::detail {
namespace {

// Old messages may be destroyed after the plugin that contains this code was closed. So this
// keeps the plugin loaded; an executable stays loaded anyway, and is not found by its name here.
void pin_object_of(void (*code)(const void*, void*) noexcept) noexcept {
  Dl_info where{};
  if (::dladdr(reinterpret_cast<const void*>(code), &where) == 0) return;
  (void)::dlopen(where.dli_fname, RTLD_LAZY | RTLD_NOLOAD | RTLD_NODELETE);
}

// For a publisher that the present daemon refuses, and that continues in a previous session:
// memory in further windows is foreign there, because no peer in that session will ever have
// those windows.
WindowSet windows_of_former(void* session) noexcept {
  const std::uint64_t count = static_cast<const Context*>(session)->announced_windows();
  const WindowSet all = Context::instance().shared_heap().windows(nullptr);
  WindowSet known;
  for (std::size_t i = 0; i < all.count(); ++i) {
    for (std::uint64_t w = 0; w < count; ++w) {
      if (Heap::window(w).base == all[i].begin) (void)known.add(all[i].begin, all[i].end);
    }
  }
  return known;
}
std::uint64_t leave_of_former(void* session) noexcept {
  const SharedHeap heap = Context::instance().shared_heap();
  const std::uint64_t strays = heap.leave(heap.context);
  // An unseen part may be in a further window.
  const bool has_further = windows_of_former(session).count() != heap.windows(heap.context).count();
  return strays + (has_further ? 1 : 0);
}

HeapUse heap_use_of(const MessageType& type, const MessageCode& code, bool may_copy) {
  return {code.uses_shared_allocator, may_copy && is_copied_into_block(type)};
}

class PublisherSource final : public CallbackSource {
 public:
  PublisherSource(std::shared_ptr<PublisherEndpoint> endpoint, EventCallbacks events) noexcept
      : endpoint_(std::move(endpoint)), events_(std::move(events)) {}
  ~PublisherSource() override {
    const UserSignals as_creator(signals);
    events_ = {};
  }
  bool has_work() const noexcept override {
    return endpoint_->events().has_pending() || is_look_due();
  }
  Clock::time_point due() const noexcept override {
    return reports_times_ ? endpoint_->events().look_due() : Clock::time_point::max();
  }
  bool run_one() override {
    if (is_look_due()) endpoint_->look_at_times();
    return endpoint_->events().run_one(events_);
  }

 private:
  bool is_look_due() const noexcept { return reports_times_ && due() <= Clock::now(); }

  const std::shared_ptr<PublisherEndpoint> endpoint_;
  EventCallbacks events_;
  const bool reports_times_ = events_.deadline != nullptr || events_.liveliness_lost != nullptr;
};

}  // namespace

Result<std::shared_ptr<UntypedPublisher>> UntypedPublisher::create(const EndpointName& name,
                                                                   MessageType type, const QoS& qos,
                                                                   const PublisherOptions& options,
                                                                   const MessageCode& code) {
  if (Result<void> fits = check_qos(qos); !fits) return tl::unexpected<Failure>(fits.error());
  // Best available: reliable, which matches every subscription.
  QoS offered = qos;
  if (qos.is_best_available()) offered.reliable();
  std::shared_ptr<UntypedPublisher> publisher(
      new UntypedPublisher(std::move(type), name.topic, offered));
  const Result<bool> off = is_switched_off();
  if (!off) return tl::unexpected<Failure>(off.error());
  if (*off) return publisher;
  if (options.events()) {
    auto group = callback_groups::of_endpoint(name.node, options.callback_group());
    if (!group) return tl::unexpected<Failure>(group.error());
    publisher->group_ = std::move(*group);
  }
  EndpointRequest request;
  request.topic = name.topic;
  request.node = name.node;
  request.domain = name.domain;
  request.type = publisher->type_.name();
  request.layout_hash = publisher->type_.layout_hash();
  request.qos = to_abi(offered);
  request.heap_use = heap_use_of(publisher->type_, code, options.may_copy());
  request.persistent_id = name.persistent_id;
  request.announces_persistent_id_later = name.announces_persistent_id_later;
  auto endpoint = Context::instance().create_publisher(request, code.end);
  if (!endpoint) return tl::unexpected<Failure>(endpoint.error());
  publisher->endpoint_ = std::move(*endpoint);
  publisher->copies_ = Context::instance().heap()->copies();
  pin_object_of(code.end.code);
  if (options.events()) {
    GroupCallbacks& callbacks = *publisher->group_->state().callbacks;
    publisher->endpoint_->events().wake_for(options.events(), callbacks.wait_set());
    publisher->source_ = std::make_shared<PublisherSource>(publisher->endpoint_, options.events());
    callbacks.add(publisher->source_);
  }
  return publisher;
}

Result<void> prepare_to_publish(const MessageType& type, const MessageCode& code) {
  return Context::instance().prepare_to_publish(heap_use_of(type, code, true));
}

BlockCopy::~BlockCopy() {
  if (start_ != nullptr) (void)block_heap().deallocate(start_);
}

UntypedPublisher::~UntypedPublisher() {
  if (source_ != nullptr) group_->state().callbacks->remove(*source_, group_);
  if (endpoint_ != nullptr) Context::instance().destroy(endpoint_, end_);
}

Errc UntypedPublisher::state() const noexcept {
  if (endpoint_ == nullptr) return Errc::switched_off;
  return service_state();
}

bool UntypedPublisher::is_active() const noexcept { return endpoint_ != nullptr && !is_revoked(); }

Errc UntypedPublisher::publish(void* message, std::size_t object_bytes,
                               std::uint64_t message_bytes) noexcept {
  switch (endpoint_->publish(message, object_bytes, message_bytes)) {
    case dataplane::PublishOutcome::published:
      return Errc::ok;
    case dataplane::PublishOutcome::no_slot:
      return Errc::no_slot;
    case dataplane::PublishOutcome::would_block:
      return Errc::would_block;
  }
  return Errc::internal;
}

void UntypedPublisher::make_room() const noexcept {
  if (state() != Errc::ok) return;
  if (endpoint_->owner() == &Context::instance()) [[likely]]
    endpoint_->make_room();
  else
    endpoint_->present(endpoint_)->make_room();
}

bool UntypedPublisher::has_more_room() const noexcept {
  Context& present = Context::instance();
  bool some = present.has_more_room();
  const auto endpoint = endpoint_->present(endpoint_);
  if (endpoint->owner() != &present) some = endpoint->has_more_room() || some;
  endpoint->lacked_room();
  return some;
}

void UntypedPublisher::count_adoption(const Result<Adoption>& adopted) noexcept {
  AGNOCAST_CRASH_POINT(C_original);
  if (adopted) {
    endpoint_->count_adopted(adopted->adopted_bytes);
  } else if (adopted.error().code != Errc::user_code_threw) {
    endpoint_->count_heap_exhausted();
  }
}

BlockCopy UntypedPublisher::copy(const void* message) noexcept {
  if (const Errc state = this->state(); state != Errc::ok) return BlockCopy(state);
  make_room();
  const MessageCopy copy(type_, message);
  const SharedHeap heap = this->heap();
  // The second attempt has more room, or is made in the window to which the heap has moved.
  for (int attempt = 0; attempt < 2; ++attempt) {
    BlockCopy made(block_heap().allocate(copy.alignment(), copy.block_bytes()), 0);
    if (made.start() != nullptr) {
      if (!copy.write(made.start())) return BlockCopy(Errc::loan_invalid);
      const Residency found =
          check_residency(type_, static_cast<std::byte*>(made.start()) + type_.header_bytes(),
                          heap.windows(heap.context));
      if (found.is_resident()) {
        made.set_bytes(found.message_bytes);
        count_adoption(Adoption{found.message_bytes, found.message_bytes});
        return made;
      }
    }
    if (made.start() == nullptr && !has_more_room()) break;
  }
  count_adoption(tl::unexpected<Failure>(heap.full()));
  return BlockCopy(heap.full().code);
}

bool UntypedPublisher::is_current(const BlockCopy& copy) const noexcept {
  const SharedHeap heap = this->heap();
  return copy.start() != nullptr && heap.windows(heap.context).contains(copy.start(), 1);
}

PublishResult UntypedPublisher::publish(BlockCopy& copy) noexcept {
  if (copy.start() == nullptr) return {copy.code(), 0};
  if (const Errc state = this->state(); state != Errc::ok) return {state, copy.bytes()};
  const Errc outcome = publish(copy.start(), type_.message_bytes(), copy.bytes());
  if (outcome == Errc::ok) copy.release();
  return {outcome, copy.bytes()};
}

SharedHeap UntypedPublisher::heap() const noexcept {
  Context& present = Context::instance();
  SharedHeap heap = present.shared_heap();
  if (endpoint_ == nullptr || endpoint_->owner() == &present) [[likely]]
    return heap;
  Context* const publishes_in = Context::of(*endpoint_->present(endpoint_));
  if (publishes_in == &present) return heap;
  heap.context = publishes_in;
  heap.windows = windows_of_former;
  heap.leave = leave_of_former;
  return heap;
}
std::size_t UntypedPublisher::subscription_count() const noexcept {
  return endpoint_ != nullptr ? endpoint_->subscription_count() : 0;
}
std::size_t UntypedPublisher::local_subscription_count() const noexcept {
  using Readers = PublisherEndpoint::Readers;
  return endpoint_ != nullptr ? endpoint_->subscription_count(Readers::local) : 0;
}
std::size_t UntypedPublisher::linked_subscription_count() const noexcept {
  using Readers = PublisherEndpoint::Readers;
  return endpoint_ != nullptr ? endpoint_->subscription_count(Readers::linked) : 0;
}

bool UntypedPublisher::wait_for_all_acked(Timeout timeout) const noexcept {
  if (endpoint_ == nullptr) return true;
  if (state() != Errc::ok) return false;
  // What was published before is in the present endpoint, and in the first one if that has moved.
  const std::shared_ptr<PublisherEndpoint> newest = endpoint_->present(endpoint_);
  const std::uint64_t first_head = endpoint_->head_sequence(), head = newest->head_sequence();
  while (!endpoint_->is_taken(first_head) || !newest->is_taken(head)) {
    if (!timeout.wait() || state() != Errc::ok) return false;
  }
  return true;
}

bool UntypedPublisher::wait_for_local_links(Timeout timeout) const noexcept {
  using Readers = PublisherEndpoint::Readers;
  if (endpoint_ == nullptr) return true;
  while (state() == Errc::ok) {
    if (endpoint_->subscription_count(Readers::local_linked) >=
        endpoint_->subscription_count(Readers::local))
      return true;
    if (!timeout.wait()) return false;
  }
  return false;
}

std::uint64_t UntypedPublisher::persistent_id() const noexcept {
  return endpoint_ != nullptr ? endpoint_->persistent_id() : 0;
}
std::uint64_t UntypedPublisher::generation() const noexcept {
  return endpoint_ != nullptr ? endpoint_->present(endpoint_)->identity().generation : 0;
}
void UntypedPublisher::announce_persistent_id() noexcept {
  if (endpoint_ != nullptr) endpoint_->announce_persistent_id();
}
std::vector<std::uint64_t> UntypedPublisher::reader_persistent_ids() const {
  return endpoint_ != nullptr ? endpoint_->reader_persistent_ids() : std::vector<std::uint64_t>();
}
void UntypedPublisher::tell(std::shared_ptr<Watch> watch) noexcept {
  if (endpoint_ != nullptr) endpoint_->events().tell(std::move(watch));
}

bool Timeout::wait() noexcept {
  const auto left = end_ - std::chrono::steady_clock::now();
  if (left <= left.zero()) return false;
  std::this_thread::sleep_for(std::min<std::chrono::steady_clock::duration>(left, step_));
  step_ = std::min(step_ * 2, std::chrono::microseconds(1000));
  return true;
}

std::uint64_t UntypedPublisher::callback_exception_count() const noexcept {
  return source_ != nullptr ? source_->exception_count.load(std::memory_order_relaxed) : 0;
}
MatchedInfo UntypedPublisher::matched_status() noexcept {
  return endpoint_ != nullptr ? endpoint_->events().matched_status() : MatchedInfo{};
}
std::chrono::steady_clock::time_point UntypedPublisher::event_due() const noexcept {
  return endpoint_ != nullptr ? endpoint_->events().look_due()
                              : std::chrono::steady_clock::time_point::max();
}
DeadlineMissedInfo UntypedPublisher::deadline_missed_status() noexcept {
  if (endpoint_ == nullptr) return {};
  endpoint_->look_at_times();
  return endpoint_->events().deadline_missed_status();
}
LivelinessLostInfo UntypedPublisher::liveliness_lost_status() noexcept {
  if (endpoint_ == nullptr) return {};
  endpoint_->look_at_times();
  return endpoint_->events().liveliness_lost_status();
}
bool UntypedPublisher::assert_liveliness() noexcept {
  return is_active() && endpoint_->assert_liveliness();
}
IncompatibleQosInfo UntypedPublisher::incompatible_qos_status() noexcept {
  return endpoint_ != nullptr ? endpoint_->events().incompatible_qos_status()
                              : IncompatibleQosInfo{};
}
HeapCollisionInfo UntypedPublisher::heap_collision_status() noexcept {
  return endpoint_ != nullptr ? endpoint_->events().heap_collision_status() : HeapCollisionInfo{};
}

IncompatibleTypeInfo UntypedPublisher::incompatible_type_status() noexcept {
  return endpoint_ != nullptr ? endpoint_->events().incompatible_type_status()
                              : IncompatibleTypeInfo{};
}

}  // namespace agnocast::detail
