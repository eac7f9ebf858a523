// SPDX-License-Identifier: Apache-2.0
//
// SubscriptionEndpoint: how it goes on in the next session when its own is orphaned: it gets a
// successor there, reads its own queues to their end, and leaves its counters to the first endpoint
// of the line.

#include <client/endpoint/subscription_endpoint.hpp>
#include <client/process/steps.hpp>

#include <algorithm>
#include <new>
#include <utility>

namespace agnocast {

void SubscriptionEndpoint::be_alone() noexcept {
  {
    const std::lock_guard lock(mutex_);
    is_alone_ = true;
    if (closed_) {
      for (const auto& link : links_) link->core_.stand_aside();
    }
  }
  wait_set_->wake();
}

void SubscriptionEndpoint::expect_successor() {
  const std::lock_guard lock(mutex_);
  successors_.reserve(successors_.size() + 1);
}

bool SubscriptionEndpoint::add_successor(const std::shared_ptr<SubscriptionEndpoint>& successor) {
  {
    const std::lock_guard lock(mutex_);
    if (closed_) return false;
    if (!successors_.empty()) successors_.back()->be_succeeded();
    successor->counts_ = counts_;  // nobody takes from it yet
    successors_.push_back(successor);
  }
  AGNOCAST_CRASH_POINT(C_succeeded);
  be_succeeded();
  wait_set_->wake();  // rings for its earlier messages came before it was known here
  events_->moved();
  return true;
}

std::shared_ptr<SubscriptionEndpoint> SubscriptionEndpoint::in_session(
    const EndpointOwner* owner, const std::shared_ptr<SubscriptionEndpoint>& self) const {
  if (self_.owner == owner) return self;
  const std::lock_guard lock(mutex_);
  for (const auto& successor : successors_) {
    if (successor->owner() == owner) return successor;
  }
  return nullptr;
}

std::size_t SubscriptionEndpoint::successor_count() const noexcept {
  const std::lock_guard lock(mutex_);
  return successors_.size();
}

std::shared_ptr<SubscriptionEndpoint> SubscriptionEndpoint::successor(
    std::size_t number) const noexcept {
  const std::lock_guard lock(mutex_);
  return number < successors_.size() ? successors_[number] : nullptr;
}

void SubscriptionEndpoint::collect_alone() {
  bool found = false;
  {
    const std::lock_guard lock(mutex_);
    for (auto at = links_.begin(); at != links_.end();) {
      const std::shared_ptr<Link>& link = *at;
      if (link->has_moved() || !link->peer().is_alive()) found |= cease(*link);
      const bool over = closed_ || (link->ceased_ && !link->core_.has_news());
      link->closing_.store(over, std::memory_order_release);
      if (!over || link->held_count() != 0) {
        ++at;
        continue;
      }
      if (link->keeps_history() && link->has_moved() && link->core_.has_begun() &&
          std::find(followed_.begin(), followed_.end(), link->origin()) == followed_.end())
        followed_.push_back(link->origin());
      newest_before_ns_ =
          std::max(newest_before_ns_, std::min(link->core_.newest_stamp(), monotonic_ns()));
      lost_before_ += link->core_.lost();
      malformed_before_ += link->core_.malformed();
      unreachable_before_ += link->core_.unreachable();
      at = links_.erase(at);
    }
  }
  if (found) wait_set_->wake();
}

bool SubscriptionEndpoint::is_finished() const noexcept {
  const std::lock_guard lock(mutex_);
  return (closed_ || is_succeeded_.load(std::memory_order_acquire)) && links_.empty();
}

void SubscriptionEndpoint::finish() noexcept {
  {
    const std::lock_guard lock(mutex_);
    has_finished_ = true;
  }
  if (const auto first = first_.lock()) first->absorb(*this);
}

/// Takes over the counters of a successor that has finished, and removes it.
void SubscriptionEndpoint::absorb(SubscriptionEndpoint& successor) noexcept {
  std::shared_ptr<SubscriptionEndpoint> gone;  // after the lock
  const std::lock_guard lock(mutex_);
  const auto found = std::find_if(successors_.begin(), successors_.end(),
                                  [&](const auto& entry) { return entry.get() == &successor; });
  if (found == successors_.end()) return;
  const std::lock_guard its_lock(successor.mutex_);
  newest_before_ns_ = std::max(newest_before_ns_, successor.newest_before_ns_);
  arrived_ += std::exchange(successor.arrived_, 0);
  lost_before_ += std::exchange(successor.lost_before_, 0);
  malformed_before_ += std::exchange(successor.malformed_before_, 0);
  unreachable_before_ += std::exchange(successor.unreachable_before_, 0);
  try {
    followed_.insert(followed_.end(), successor.followed_.begin(), successor.followed_.end());
  } catch (const std::bad_alloc&) {
    // History may come twice.
  }
  gone = std::move(*found);
  successors_.erase(found);
}

}  // namespace agnocast
