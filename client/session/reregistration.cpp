// SPDX-License-Identifier: Apache-2.0

#include <base/immortal.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/library_thread.hpp>
#include <client/process/steps.hpp>
#include <client/process/user_code.hpp>
#include <client/session/reregistration.hpp>

#include <algorithm>
#include <new>
#include <thread>
#include <utility>

namespace agnocast {
namespace {

/// Returns whether every daemon would answer the same.
bool is_final(Errc code) noexcept {
  return code == Errc::revoked || code == Errc::shut_down || code == Errc::invalid_argument;
}

bool is_refusal(Errc code) noexcept {
  return is_mended_by_people(code) || code == Errc::protocol_violation;
}

/// Returns whether there is no daemon for other requests either.
bool is_away(const Result<void>& result) noexcept {
  return !result && (result.error().code == Errc::daemon_not_running ||
                     result.error().code == Errc::started_anew);
}

void keep_first(Result<void>& problem, Result<void> next) {
  if (problem || is_away(next)) problem = std::move(next);
}

template <class Entries, class Gone>
void forget(Entries& entries, Gone gone) {
  entries.erase(std::remove_if(entries.begin(), entries.end(), gone), entries.end());
}

}  // namespace

Reregistration& Reregistration::instance() noexcept { return immortal<Reregistration>(); }

Reregistration::Request::Request(const EndpointRequest& request)
    : topic(request.topic), type(request.type), node(request.node), rest(request) {}

EndpointRequest Reregistration::Request::get() const {
  EndpointRequest request = rest;
  request.topic = topic;
  request.type = type;
  request.node = node;
  return request;
}

// --- what there is to move

void Reregistration::add(const std::shared_ptr<PublisherEndpoint>& publisher,
                         const EndpointRequest& request, const detail::MessageEnd& end_message) {
  {
    const std::lock_guard lock(mutex_);
    forget(publishers_, [](const Publisher& entry) { return entry.endpoint.expired(); });
    publishers_.push_back({publisher, Request(request), end_message});
  }
  check_added(Context::of(*publisher));
}

void Reregistration::add(const std::shared_ptr<SubscriptionEndpoint>& subscription,
                         const EndpointRequest& request) {
  {
    const std::lock_guard lock(mutex_);
    forget(subscriptions_, [](const Subscription& entry) { return entry.endpoint.expired(); });
    subscriptions_.push_back({subscription, Request(request)});
  }
  check_added(Context::of(*subscription));
}

void Reregistration::add(const std::shared_ptr<WaitSet>& wait_set) {
  {
    const std::lock_guard lock(mutex_);
    forget(wait_sets_, [](const std::weak_ptr<WaitSet>& entry) { return entry.expired(); });
    wait_sets_.push_back(wait_set);
  }
  if (!wait_set->index_in(&Context::instance())) begin();
}

// The endpoint may have been created in a session that was lost before it was registered here.
void Reregistration::check_added(const Context* context) noexcept {
  if (context != &Context::instance()) begin();
}

void Reregistration::release_places(const Context& former) noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& entry : wait_sets_) {
    if (const auto wait_set = entry.lock()) wait_set->remove(&former);
  }
}

bool Reregistration::wait_for_next(const Context& lost, Clock::time_point deadline) {
  std::unique_lock lock(mutex_);
  return changed_.wait_until(lock, deadline, [&] {
    return is_refused_ || &Context::instance() != &lost;
  }) && &Context::instance() != &lost;
}

// --- the thread

void Reregistration::begin() noexcept {
  const std::lock_guard lock(mutex_);
  is_wanted_ = true;
  changed_.notify_all();
  start();
}

void Reregistration::go_on() noexcept {
  const std::lock_guard lock(mutex_);
  if (is_running_) return;
  is_wanted_ = true;
  start();
}

void Reregistration::start() noexcept {
  if (is_running_ || is_hopeless_ || exit_has_begun()) return;
  is_running_ = LibraryThread::start(
                    "agnocast-move",
                    [](void* self) -> void* {
                      static_cast<Reregistration*>(self)->run();
                      return nullptr;
                    },
                    this) == 0;
}

void Reregistration::pause(std::chrono::milliseconds duration) {
  std::unique_lock lock(mutex_);
  changed_.wait_for(lock, duration, [&] { return is_wanted_ || LibraryThread::is_over(); });
}

void Reregistration::run() noexcept {
  const LibraryThread registered(
      [](void* self) noexcept { static_cast<Reregistration*>(self)->changed_.notify_all(); }, this);
  for (;;) {
    {
      const std::lock_guard lock(mutex_);
      if (!is_wanted_ || is_hopeless_ || exit_has_begun() || LibraryThread::is_over()) {
        is_running_ = false;
        return;
      }
      is_wanted_ = false;
    }
    try {
      run_once();
    } catch (const std::bad_alloc&) {
      begin();
      std::this_thread::sleep_for(pause_without_memory);
    }
  }
}

void Reregistration::run_once() {
  while (Context::instance().state_.is_alone() && !exit_has_begun() && !LibraryThread::is_over()) {
    Context& former = Context::instance();
    const Result<void> began = begin_next(former);
    if (began) {
      pause_ = pause_first;
      const std::lock_guard lock(mutex_);
      is_refused_ = false;
      break;
    }
    const Failure& why = began.error();
    if (is_final(why.code) || is_refusal(why.code)) {
      former.control_.stay_orphaned(why);
      const std::lock_guard lock(mutex_);
      is_refused_ = true;
      is_hopeless_ = is_final(why.code);
      changed_.notify_all();
      if (is_hopeless_) return;
      pause_ = Reconnection::pause_refused;
    } else if (why.code != Errc::daemon_not_running && why.code != Errc::started_anew) {
      former.control_.tell_reason(why.code);
    }
    {
      const std::lock_guard lock(mutex_);
      is_wanted_ = false;
    }
    pause(pause_);
    pause_ = std::min(pause_ * 2, pause_last);
  }
  move_everything(Context::instance());
}

Result<void> Reregistration::begin_next(Context& former) {
  std::unique_ptr<Context, Context::Drop> next(new Context);
  next->registration_.continue_from(former.registration_);
  next->state_.begin_beside(former.state_);
  {
    const std::lock_guard lock(former.connecting_);
    next->heap_.continue_from(former.heap_);
  }
  AGNOCAST_CRASH_POINT(C_next);
  if (Result<void> known = next->become_known(); !known) return known;
  if (Result<void> brought =
          next->heap_.bring(next->registration_.connection(), next->registration_.region_base());
      !brought)
    return brought;
  Context* const begun = next.release();
  AGNOCAST_CRASH_POINT(C_present);
  Context::present_.store(begun, std::memory_order_release);
  AGNOCAST_CRASH_POINT(C_present);
  begun->state_.step(SessionState::Step::be_present);
  const std::lock_guard lock(mutex_);
  changed_.notify_all();
  return {};
}

template <class Which>
void Reregistration::abandon_pending(Which which) noexcept {
  forget(pending_, [&](const Pending& entry) {
    const bool found = which(entry);
    if (found) entry.successor->abandon();
    return found;
  });
}

// Also moves endpoints that were created meanwhile in a session that is the previous one by now.
void Reregistration::move_everything(Context& present) {
  // An earlier attempt may have run out of memory, and may have been for another session.
  abandon_pending([&](const Pending& entry) { return entry.successor->owner() != &present; });
  auto look = std::chrono::milliseconds{1};
  auto again = std::chrono::milliseconds{1000};  // after a refusal
  for (bool first = true; !exit_has_begun() && !LibraryThread::is_over(); first = false) {
    if (present.state_.is_alone()) {
      abandon_pending([](const Pending&) { return true; });
      return begin();
    }
    Result<void> made = make_places(present);
    // A refusal for one endpoint does not keep the others from moving.
    if (!is_away(made)) keep_first(made, make_subscriptions(present));
    if (!is_away(made)) keep_first(made, make_publishers(present));
    if (first) {
      present.state_.step(SessionState::Step::arrived);
      present.wake_control();
    }
    for (auto entry = pending_.begin(); entry != pending_.end();)
      entry = try_to_move(present, *entry) ? pending_.erase(entry) : entry + 1;
    if (pending_.empty()) {
      // Refused publishers go on where they were; the heap does not wait for them.
      if (!is_away(made) && present.heap_.growth().permit()) present.wake_control();
      if (made) return;
    }
    if (!pending_.empty()) {
      pause(look);
      look = std::min(look * 2, std::chrono::milliseconds{20});
    } else {
      pause(again);
      again = std::min(again * 2, pause_last);
    }
    const std::lock_guard lock(mutex_);
    is_wanted_ = false;
  }
}

std::vector<std::shared_ptr<WaitSet>> Reregistration::wait_sets() {
  std::vector<std::shared_ptr<WaitSet>> all;
  const std::lock_guard lock(mutex_);
  for (const auto& entry : wait_sets_) {
    if (auto wait_set = entry.lock()) all.push_back(std::move(wait_set));
  }
  return all;
}

Result<void> Reregistration::make_places(Context& present) {
  Result<void> problem;
  for (const auto& wait_set : wait_sets()) {
    AGNOCAST_CRASH_POINT(C_place);
    keep_first(problem, present.make_place(*wait_set));
    AGNOCAST_CRASH_POINT(C_place);
    if (is_away(problem)) break;
  }
  return problem;
}

Result<void> Reregistration::make_subscriptions(Context& present) {
  std::vector<std::pair<std::shared_ptr<SubscriptionEndpoint>, Request>> all;
  {
    const std::lock_guard lock(mutex_);
    for (const Subscription& entry : subscriptions_) {
      auto endpoint = entry.endpoint.lock();
      if (endpoint != nullptr && !endpoint->is_closed() &&
          endpoint->in_session(&present, endpoint) == nullptr)
        all.emplace_back(std::move(endpoint), entry.request);
    }
  }
  Result<void> problem;
  for (const auto& [endpoint, request] : all) {
    endpoint->expect_successor();
    auto made =
        present.make_subscription(request.get(), endpoint->shared_wait_set(),
                                  {endpoint->identity().persistent_id, endpoint->shared_events()});
    if (!made) {
      problem = tl::unexpected<Failure>(made.error());
      if (is_away(problem)) break;
    } else {
      AGNOCAST_CRASH_POINT(C_successor);
      (*made)->continues(endpoint);
      AGNOCAST_CRASH_POINT(C_successor);
      if (endpoint->add_successor(*made)) continue;
      (*made)->close();  // its owner has closed it meanwhile
      present.let_leave(**made);
    }
  }
  return problem;
}

Result<void> Reregistration::make_publishers(Context& present) {
  std::vector<Publisher> all;
  {
    const std::lock_guard lock(mutex_);
    all = publishers_;
  }
  Result<void> problem;
  for (const Publisher& entry : all) {
    const auto publisher = entry.endpoint.lock();
    if (publisher == nullptr || publisher->has_ended() ||
        publisher->present(publisher)->owner() == &present ||
        std::any_of(pending_.begin(), pending_.end(),
                    [&](const Pending& other) { return other.publisher == publisher; }))
      continue;
    pending_.reserve(pending_.size() + 1);  // first, so that nothing is lost if there is no memory
    auto made = present.make_publisher(entry.request.get(), entry.end_message,
                                       {publisher->persistent_id(), publisher->shared_events()});
    if (made) {
      AGNOCAST_CRASH_POINT(C_migration_successor);
      pending_.push_back({publisher, *made, Clock::now()});
    } else {
      problem = tl::unexpected<Failure>(made.error());
      if (is_away(problem)) break;
    }
  }
  return problem;
}

/// Returns true when there is nothing left to do for it.
bool Reregistration::try_to_move(Context& present, const Pending& pending) {
  const auto& [publisher, successor, since] = pending;
  const auto before = publisher->present(publisher);
  if (!publisher->has_ended()) {
    if (!before->is_succeeded_by(*successor) && Clock::now() - since < move_patience) return false;
    if (before->move_to(successor) && before != publisher) publisher->redirect_to(successor);
    Context::of(*before)->wake_control();
  }
  if (publisher->has_ended()) AGNOCAST_CRASH_POINT(C_successor_leaves);
  if (publisher->has_ended()) present.let_leave(*successor);  // also if it ended in between
  return true;
}

}  // namespace agnocast
