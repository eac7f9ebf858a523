// SPDX-License-Identifier: Apache-2.0
//
// Context: what a process asks for once it is a member: its heap, sleepers and endpoints, and their end.
// How it becomes a member: joining.cpp; coming back: rejoining.cpp; what it is told: control_thread.cpp.

#include <client/session/context.hpp>

#include <base/text.hpp>
#include <client/heap/heap_return.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/steps.hpp>
#include <client/session/reregistration.hpp>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <utility>

namespace agnocast {

namespace wire = abi::wire;
using wire::Kind;
using wire::Opcode;

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
    // The control thread comes to them.
  }
  heap.resume();
  bool some = false;
  for (const auto& publisher : all) some = publisher->has_more_room() || some;
  return some;
}

bool Context::is_connected() const noexcept {
  return !is_forked_child() && state_.is_connected();
}

ConnectionState Context::state() const noexcept {
  return is_forked_child() ? ConnectionState::unconnected : state_.connection();
}

ConnectionState connection_state() noexcept { return Context::instance().state(); }
Errc island_reason() noexcept { return Context::instance().island_reason(); }

Result<void> Context::set_heap_scope(HeapScope scope) noexcept {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  return heap_.set_scope(scope);
}

namespace {

Result<wire::CreateEndpoint> describe(const EndpointRequest& request,
                                      std::uint64_t executor) noexcept {
  wire::CreateEndpoint body{};
  body.qos = abi::pack_qos(request.qos);
  body.layout_hash = request.layout_hash;
  body.executor = executor;
  body.quota = request.quota | (request.quota_or_less ? wire::quota_or_less : 0);
  if (!write_name(body.topic, request.topic))
    return fail(Errc::invalid_name, "a topic name of more than 255 characters");
  if (!write_name(body.type, request.type))
    return fail(Errc::invalid_name, "a type name of more than 255 characters");
  if (!write_name(body.node, request.node))
    return fail(Errc::invalid_name, "a node name of more than 255 characters");
  return body;
}

}  // namespace

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

/// Also in those to come. Otherwise it is not there.
template <class Endpoint, class... More>
void Context::in_all_memberships(const std::shared_ptr<Endpoint>& endpoint, const More&... more) {
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
    return present.make_publisher(request, end_message, {request.lineage, nullptr});
  });
  if (made) in_all_memberships(*made, request, end_message);
  return made;
}

Result<std::shared_ptr<SubscriptionEndpoint>> Context::create_subscription(
    const EndpointRequest& request, std::shared_ptr<Sleeper> sleeper) {
  auto made = in_present([&](Context& present) {
    return present.make_subscription(request, sleeper, {request.lineage, nullptr});
  });
  if (made) in_all_memberships(*made, request);
  return made;
}

Result<std::shared_ptr<Sleeper>> Context::create_sleeper() {
  auto sleeper = Sleeper::make();
  if (!sleeper) return sleeper;
  Result<void> made = in_present([&](Context& present) { return present.make_place(**sleeper); });
  if (!made) return tl::unexpected<Failure>(made.error());
  Reregistration::instance().add(*sleeper);
  return sleeper;
}

Result<std::shared_ptr<Sleeper>> Context::idle_sleeper() {
  if (Result<void> refused = refuse_forked_child(); !refused)
    return tl::unexpected<Failure>(refused.error());
  struct Idle {
    std::mutex making;
    std::shared_ptr<Sleeper> sleeper;
  };
  static Idle* const idle = new Idle;  // immortal, as the context
  const std::lock_guard lock(idle->making);
  if (idle->sleeper == nullptr) {
    auto made = create_sleeper();
    if (!made) return made;
    idle->sleeper = std::move(*made);
  }
  return idle->sleeper;
}

/// Of one that continues none: nobody else has the same, in whatever membership.
std::uint64_t Context::lineage_of(const Continued& continued, const wire::EndpointCreated& made,
                                  Kind kind) const noexcept {
  std::uint64_t sum = continued.lineage;
  if (sum == 0) {
    for (const std::uint64_t part : {registration_.incarnation(), registration_.client().first, std::uint64_t{made.topic}, made.index,
                                     made.generation, static_cast<std::uint64_t>(kind)}) {
      sum = (sum ^ part) * 0x9e3779b97f4a7c15;
      sum ^= sum >> 29;
    }
  }
  return sum != 0 ? sum : 1;
}

Result<void> Context::open_heap_for(bool uses_shared_allocator) {
  if (Result<void> connected = connect(); !connected) return connected;
  Result<void> opened = heap_.open(registration_.connection(), registration_.region_base(),
                                   []() noexcept { Context::instance().wake_control(); });
  if (!opened || uses_shared_allocator) return opened;
  return heap_.opened().check_interposition();
}

Result<void> Context::prepare_to_publish(bool uses_shared_allocator) {
  return in_present([&](Context& present) { return present.open_heap_for(uses_shared_allocator); });
}

Result<std::shared_ptr<PublisherEndpoint>> Context::make_publisher(
    const EndpointRequest& request, const detail::MessageEnd& end_message, Continued continued) {
  if (Result<void> heap = open_heap_for(request.uses_shared_allocator); !heap)
    return tl::unexpected<Failure>(heap.error());
  const Result<wire::CreateEndpoint> body = describe(request, 0);
  if (!body) return tl::unexpected<Failure>(body.error());
  std::shared_ptr<PublisherEndpoint> publisher;
  Result<void> created = registration_.connection().request(
      Opcode::create_publisher, *body,
      [&](Incoming& packet) -> Result<void> {
        wire::EndpointCreated made{};
        if (!packet.read(made) || made.topic >= abi::topic_count_max ||
            made.index >= abi::publisher_count_max) {
          return fail(Errc::protocol_violation, "a new publisher");
        }
        if (Result<void> opened = registration_.open_extents(made, abi::publisher_extent_bytes); !opened)
          return opened;
        const PublisherEndpoint::Core::Identity core{{registration_.board().base(), abi::topic_offset(made.topic)},
                                                     {registration_.region_base(), made.extent},
                                                     made.index,
                                                     made.generation,
                                                     made.first_sequence,
                                                     request.qos,
                                                     made.slot_count,
                                                     PublisherEndpoint::lazy_limit};
        publisher = std::make_shared<PublisherEndpoint>(
            PublisherEndpoint::Identity{core, made.topic, end_message, registration_.waker(), continued.events,
                                        this, lineage_of(continued, made, Kind::publisher),
                                        request.says_lineage_later && continued.events == nullptr,
                                        []() noexcept { return Context::instance().has_more_room(); },
                                        request.signals});
        endpoints_.add(publisher);
        return {};
      },
      [this](Incoming& packet) { return adopt_late(Kind::publisher, packet); });
  if (!created) return tl::unexpected<Failure>(created.error());
  return publisher;
}

Result<std::shared_ptr<SubscriptionEndpoint>> Context::make_subscription(
    const EndpointRequest& request, const std::shared_ptr<Sleeper>& sleeper, Continued continued) {
  if (Result<void> connected = connect(); !connected)
    return tl::unexpected<Failure>(connected.error());
  // The sleeper may be older than this membership.
  if (Result<void> place = make_place(*sleeper); !place)
    return tl::unexpected<Failure>(place.error());
  const Result<wire::CreateEndpoint> body = describe(request, *sleeper->index_in(this));
  if (!body) return tl::unexpected<Failure>(body.error());
  std::shared_ptr<SubscriptionEndpoint> subscription;
  Result<void> created = registration_.connection().request(
      Opcode::create_subscription, *body,
      [&](Incoming& packet) -> Result<void> {
        wire::EndpointCreated made{};
        if (!packet.read(made) || made.topic >= abi::topic_count_max ||
            made.index >= abi::subscription_count_max) {
          return fail(Errc::protocol_violation, "a new subscription");
        }
        if (Result<void> opened = registration_.open_extents(made, abi::subscription_extent_bytes); !opened)
          return opened;
        subscription = std::make_shared<SubscriptionEndpoint>(
            SubscriptionEndpoint::Identity{{registration_.board().base(), abi::topic_offset(made.topic)},
                                           made.topic,
                                           made.index,
                                           made.generation,
                                           registration_.region_base(),
                                           made.extent,
                                           request.qos,
                                           request.quota,
                                           request.depth_per_publisher,
                                           request.message_bytes,
                                           request.message_alignment,
                                           registration_.waker(),
                                           continued.events,
                                           this,
                                           lineage_of(continued, made, Kind::subscription)},
            sleeper);
        endpoints_.add(subscription);
        return {};
      },
      [this](Incoming& packet) { return adopt_late(Kind::subscription, packet); });
  if (!created) return tl::unexpected<Failure>(created.error());
  return subscription;
}

Result<void> Context::make_place(Sleeper& sleeper) {
  if (Result<void> connected = connect(); !connected) return connected;
  return places_.give(
      sleeper, this,
      [this]() -> Result<void> {
        if (!state_.is_alone()) return {};
        return fail(Errc::started_anew, "agnocastd has lost what it knew");
      },
      [this](std::uint64_t executor, bool again) { return open_executor(executor, again); });
}

Result<std::unique_ptr<Sleeper::Place>> Context::open_executor(std::uint64_t executor, bool again) {
  wire::ExecutorRequest request{};
  request.executor = executor;
  std::unique_ptr<Sleeper::Place> place;
  Result<void> opened = registration_.connection().request(
      Opcode::open_executor, request,
      [&](Incoming& packet) -> Result<void> {
        wire::Done answer{};
        if (Result<void> read =
                packet.read_as(Opcode::executor_opened, answer, 2, "the answer with an executor");
            !read)
          return read;
        const auto fds = packet.packet.fds();
        AGNOCAST_CRASH_POINT(C_sleeper);
        place = std::make_unique<Sleeper::Place>(
            registration_.region_base(), executor, DoorbellReceiver(std::move(fds[0]), std::move(fds[1])));
        return {};
      },
      nullptr, again);
  if (!opened) return tl::unexpected<Failure>(opened.error());
  return place;
}

// The control thread says it, now or when it is connected again.
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

// In each membership that it is in.
void Context::destroy(const std::shared_ptr<PublisherEndpoint>& publisher,
                      Reconnection::Clock::time_point end) noexcept {
  if (!is_connected()) return;
  publisher->end();
  const std::shared_ptr<PublisherEndpoint> present = publisher->present(publisher);
  if (present != publisher) publisher->context()->let_leave(*publisher, end);
  present->context()->let_leave(*present, end);
}

void Context::destroy(const std::shared_ptr<SubscriptionEndpoint>& subscription,
                      Reconnection::Clock::time_point end) noexcept {
  if (!is_connected()) return;
  subscription->close();
  // The newest first: an old one that ends meanwhile makes none be skipped.
  for (std::size_t i = subscription->successor_count(); i-- > 0;) {
    if (const auto successor = subscription->successor(i); successor != nullptr)
      successor->context()->let_leave(*successor, end);
  }
  subscription->context()->let_leave(*subscription, end);
}

}  // namespace agnocast
