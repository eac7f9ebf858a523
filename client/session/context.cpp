// SPDX-License-Identifier: Apache-2.0
//
// Context: the requests of a process that has a session: its heap, wait sets and endpoints, and
// their end. How it gets a session: joining.cpp; how it comes back: rejoining.cpp; what the daemon
// sends: control_thread.cpp.

#include <client/session/context.hpp>

#include <client/heap/block_heap.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/steps.hpp>
#include <client/session/reregistration.hpp>

#include <chrono>
#include <cstdlib>
#include <mutex>
#include <new>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast {

namespace {

// Frees a message that was copied into a heap of blocks.
constexpr detail::MessageEnd end_of_block{
    [](const void*, void* block) noexcept { (void)block_heap().deallocate(block); }, nullptr};

tl::unexpected<Failure> lost_state() noexcept {
  return fail(Errc::started_anew, "agnocastd has lost its state");
}

}  // namespace

Result<bool> is_switched_off() noexcept {
  const char* const text = ::secure_getenv("AGNOCAST");
  const std::string_view word = text != nullptr ? text : "";
  if (word.empty() || word == "on") return false;
  if (word == "off") return true;
  return fail(Errc::invalid_argument, "AGNOCAST must be on or off");
}

std::atomic<Context*> Context::present_{nullptr};

Context& Context::first() noexcept {
  static Context* const context =
      new Context;  // immortal: messages in statics outlive every static of ours
  Context* none = nullptr;
  present_.compare_exchange_strong(none, context, std::memory_order_acq_rel);
  return *context;
}

bool Context::has_more_room() noexcept {
  std::vector<std::shared_ptr<PublisherEndpoint>> all;
  const Heap& heap = *this->heap();
  heap.pause();
  try {
    all = endpoints_.publishers();
  } catch (const std::bad_alloc&) {
    // The control thread will scan them.
  }
  heap.resume();
  bool some = false;
  for (const auto& publisher : all) some = publisher->has_more_room() || some;
  return some;
}

bool Context::is_connected() const noexcept { return !is_forked_child() && state_.is_connected(); }

ConnectionState Context::state() const noexcept {
  return is_forked_child() ? ConnectionState::unconnected : state_.connection();
}

ConnectionState connection_state() noexcept { return Context::instance().state(); }
Errc orphan_reason() noexcept { return Context::instance().orphan_reason(); }

Result<void> Context::set_heap_scope(HeapScope scope) noexcept {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  return heap_.set_scope(scope);
}

template <class Work>
auto Context::in_present(Work work) -> decltype(work(instance())) {
  const auto deadline = Reconnection::Clock::now() + Connection::answer_timeout;
  for (;;) {
    Context& present = instance();
    auto done = work(present);
    if (done || done.error().code != Errc::started_anew ||
        !Reregistration::instance().wait_for_next(present, deadline))
      return done;
  }
}

/// Registers the endpoint for later sessions too; destroys it if that fails.
template <class Endpoint, class... More>
void Context::in_all_sessions(const std::shared_ptr<Endpoint>& endpoint, const More&... more) {
  try {
    Reregistration::instance().add(endpoint, more...);
  } catch (const std::bad_alloc&) {
    destroy(endpoint);
    throw;
  }
}

Result<std::shared_ptr<PublisherEndpoint>> Context::create_publisher(
    const EndpointRequest& request, const detail::MessageEnd& end_message) {
  auto made = in_present([&](Context& present) {
    return present.make_publisher(request, end_message, {request.persistent_id, nullptr});
  });
  if (made) in_all_sessions(*made, request, end_message);
  return made;
}

Result<std::shared_ptr<SubscriptionEndpoint>> Context::create_subscription(
    const EndpointRequest& request, std::shared_ptr<WaitSet> wait_set) {
  auto made = in_present([&](Context& present) {
    return present.make_subscription(request, wait_set, {request.persistent_id, nullptr});
  });
  if (made) in_all_sessions(*made, request);
  return made;
}

Result<std::shared_ptr<WaitSet>> Context::create_wait_set() {
  auto wait_set = WaitSet::make();
  if (!wait_set) return wait_set;
  Result<void> made = in_present([&](Context& present) { return present.make_place(**wait_set); });
  if (!made) return tl::unexpected<Failure>(made.error());
  Reregistration::instance().add(*wait_set);
  return wait_set;
}

Result<std::shared_ptr<WaitSet>> Context::idle_wait_set() {
  if (Result<void> refused = refuse_forked_child(); !refused)
    return tl::unexpected<Failure>(refused.error());
  struct Idle {
    std::mutex making;
    std::shared_ptr<WaitSet> wait_set;
  };
  static Idle* const idle = new Idle;  // immortal, like the context
  const std::lock_guard lock(idle->making);
  if (idle->wait_set == nullptr) {
    auto made = create_wait_set();
    if (!made) return made;
    idle->wait_set = std::move(*made);
    EndpointEvents::wake_for_polling(*idle->wait_set);
  }
  return idle->wait_set;
}

Result<void> Context::open_heap_for(HeapUse use) {
  if (Result<void> connected = connect(); !connected) return connected;
  Result<void> opened = heap_.open(
      registration_.connection(), registration_.region_base(),
      []() noexcept { Context::instance().wake_control(); }, use.by_copy);
  if (!opened) return opened;
  const Heap& heap = heap_.opened();
  if (heap.copies()) return use.by_copy ? opened : Heap::missing_hook();
  return use.by_allocator ? opened : heap.check_interposition();
}

Result<void> Context::prepare_to_publish(HeapUse use) {
  return in_present([&](Context& present) { return present.open_heap_for(use); });
}

Result<std::shared_ptr<PublisherEndpoint>> Context::make_publisher(
    const EndpointRequest& request, const detail::MessageEnd& end_message,
    const Continued& continued) {
  if (Result<void> heap = open_heap_for(request.heap_use); !heap)
    return tl::unexpected<Failure>(heap.error());
  return creations_.make_publisher(request, heap_.opened().copies() ? end_of_block : end_message,
                                   continued, []() noexcept { return instance().has_more_room(); });
}

Result<std::shared_ptr<SubscriptionEndpoint>> Context::make_subscription(
    const EndpointRequest& request, const std::shared_ptr<WaitSet>& wait_set,
    const Continued& continued) {
  if (Result<void> connected = connect(); !connected)
    return tl::unexpected<Failure>(connected.error());
  // The wait set may be older than the session.
  if (Result<void> place = make_place(*wait_set); !place)
    return tl::unexpected<Failure>(place.error());
  return creations_.make_subscription(request, wait_set, continued);
}

Result<void> Context::make_place(WaitSet& wait_set) {
  if (Result<void> connected = connect(); !connected) return connected;
  return places_.give(
      wait_set, this,
      [this]() -> Result<void> {
        if (!state_.is_alone()) return {};
        return lost_state();
      },
      [this](std::uint64_t number, bool again) { return creations_.open_wait_set(number, again); });
}

Result<void> Context::watch_graph(const abi::wire::WatchGraph& request,
                                  const Connection::OnLater& on_answer) {
  return in_present([&](Context& present) -> Result<void> {
    if (Result<void> connected = present.connect(); !connected) return connected;
    if (present.state_.is_alone()) return lost_state();
    present.registration_.connection().request_later(abi::wire::Opcode::watch_graph, request,
                                                     on_answer);
    return {};
  });
}

// The control thread sends the leave request, now or after it has reconnected.
void Context::wait_for(const Departure& departure, Reconnection::Clock::time_point end) noexcept {
  wake_control();
  departures_.wait_for(departure, registration_.connection(), end);
}

void Context::let_leave(PublisherEndpoint& publisher,
                        Reconnection::Clock::time_point end) noexcept {
  publisher.departure().want();
  wait_for(publisher.departure(), end);
}

void Context::let_leave(SubscriptionEndpoint& subscription,
                        Reconnection::Clock::time_point end) noexcept {
  AGNOCAST_CRASH_POINT(C_closed);
  subscription.departure().want();
  wait_for(subscription.departure(), end);
}

// Leaves every session that the publisher is in.
void Context::destroy(const std::shared_ptr<PublisherEndpoint>& publisher,
                      Reconnection::Clock::time_point end) noexcept {
  if (!is_connected()) return;
  publisher->end();
  const std::shared_ptr<PublisherEndpoint> present = publisher->present(publisher);
  if (present != publisher) Context::of(*publisher)->let_leave(*publisher, end);
  Context::of(*present)->let_leave(*present, end);
}

void Context::destroy(const std::shared_ptr<SubscriptionEndpoint>& subscription,
                      Reconnection::Clock::time_point end) noexcept {
  if (!is_connected()) return;
  subscription->close();
  // Newest first: if an old one is removed meanwhile, no other one is skipped.
  for (std::size_t i = subscription->successor_count(); i-- > 0;) {
    if (const auto successor = subscription->successor(i); successor != nullptr)
      Context::of(*successor)->let_leave(*successor, end);
  }
  Context::of(*subscription)->let_leave(*subscription, end);
}

}  // namespace agnocast
