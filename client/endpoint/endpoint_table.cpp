// SPDX-License-Identifier: Apache-2.0

#include <client/endpoint/endpoint_table.hpp>
#include <client/process/steps.hpp>

#include <algorithm>

namespace agnocast {
namespace {

template <class Endpoints>
auto found_in(const Endpoints& endpoints, const EndpointTable::Key& key,
              std::uint64_t generation) noexcept -> typename Endpoints::mapped_type {
  const auto found = endpoints.find(key);
  if (found == endpoints.end() || found->second->identity().generation != generation)
    return nullptr;
  return found->second;
}

template <class Endpoints>
auto all_of(const Endpoints& endpoints) {
  std::vector<typename Endpoints::mapped_type> all;
  all.reserve(endpoints.size());
  for (const auto& [key, endpoint] : endpoints) all.push_back(endpoint);
  return all;
}

}  // namespace

std::vector<std::shared_ptr<PublisherEndpoint>> EndpointTable::publishers() const {
  const std::lock_guard lock(mutex_);
  return all_of(publishers_);
}

std::vector<std::shared_ptr<SubscriptionEndpoint>> EndpointTable::subscriptions() const {
  const std::lock_guard lock(mutex_);
  return all_of(subscriptions_);
}

bool EndpointTable::is_empty() const noexcept {
  const std::lock_guard lock(mutex_);
  return publishers_.empty() && subscriptions_.empty();
}

void EndpointTable::tell(const ConnectionInfo& info) const noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& [key, publisher] : publishers_) publisher->events().connection(info);
  for (const auto& [key, subscription] : subscriptions_) subscription->events().connection(info);
}

void EndpointTable::add(const std::shared_ptr<PublisherEndpoint>& publisher) {
  const std::lock_guard lock(mutex_);
  AGNOCAST_CRASH_POINT(C_registered);
  publishers_[{publisher->topic_index(), publisher->identity().index}] = publisher;
}

void EndpointTable::add(const std::shared_ptr<SubscriptionEndpoint>& subscription) {
  const std::lock_guard lock(mutex_);
  AGNOCAST_CRASH_POINT(C_registered);
  subscriptions_[{subscription->identity().topic_index, subscription->identity().index}] =
      subscription;
}

void EndpointTable::erase(const PublisherEndpoint& publisher) noexcept {
  const std::lock_guard lock(mutex_);
  publishers_.erase({publisher.topic_index(), publisher.identity().index});
}

void EndpointTable::erase(const SubscriptionEndpoint& subscription) noexcept {
  const std::lock_guard lock(mutex_);
  subscriptions_.erase({subscription.identity().topic_index, subscription.identity().index});
}

std::shared_ptr<PublisherEndpoint> EndpointTable::publisher(
    const Key& key, std::uint64_t generation) const noexcept {
  const std::lock_guard lock(mutex_);
  return found_in(publishers_, key, generation);
}

std::shared_ptr<SubscriptionEndpoint> EndpointTable::subscription(
    const Key& key, std::uint64_t generation) const noexcept {
  const std::lock_guard lock(mutex_);
  return found_in(subscriptions_, key, generation);
}

Departure* EndpointTable::departure_of(Kind kind, const Key& key,
                                       std::uint64_t generation) const noexcept {
  if (kind == Kind::publisher) {
    const auto here = publisher(key, generation);
    return here != nullptr ? &here->departure() : nullptr;
  }
  if (kind == Kind::subscription) {
    const auto here = subscription(key, generation);
    return here != nullptr ? &here->departure() : nullptr;
  }
  return nullptr;
}

bool EndpointTable::is_linked(std::uint32_t topic, std::uint64_t publisher,
                              std::uint64_t generation) const noexcept {
  const std::lock_guard lock(mutex_);
  return std::any_of(subscriptions_.begin(), subscriptions_.end(), [&](const auto& entry) {
    return entry.first.first == topic && entry.second->is_linked_to(publisher, generation);
  });
}

bool EndpointTable::is_attached(std::uint32_t topic, std::uint64_t subscription,
                                std::uint64_t generation) const {
  const auto all = publishers();
  return std::any_of(all.begin(), all.end(), [&](const auto& publisher) {
    return publisher->topic_index() == topic && publisher->is_attached(subscription, generation);
  });
}

void EndpointTable::wake_wait_sets() const noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& [key, subscription] : subscriptions_) subscription->wait_set().wake();
}

void EndpointTable::revoke() const noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& [key, publisher] : publishers_) publisher->revoke();
  for (const auto& [key, subscription] : subscriptions_) subscription->revoke();
}

void EndpointTable::be_alone() const noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& [key, subscription] : subscriptions_) subscription->be_alone();
}

void EndpointTable::collect_subscriptions(const Unlinked& unlinked, const Drained& drained) {
  const std::lock_guard lock(mutex_);
  for (auto it = subscriptions_.begin(); it != subscriptions_.end();) {
    const Key key = it->first;
    const std::shared_ptr<SubscriptionEndpoint>& subscription = it->second;
    for (const auto& link : subscription->collect_unlinked()) {
      // A report speaks for the whole process, so none is made while another subscription of this
      // process is linked to the same publisher.
      const bool still =
          std::any_of(subscriptions_.begin(), subscriptions_.end(), [&](const auto& other) {
            return other.first.first == key.first &&
                   other.second->is_linked_to(link->publisher(), link->generation());
          });
      if (!still) unlinked(key.first, *link);
    }
    if (!subscription->is_empty()) {
      ++it;
      continue;
    }
    const std::uint64_t generation = subscription->identity().generation;
    // The wait set comes back first: a thread that sees the place free may use it.
    it = subscriptions_.erase(it);
    AGNOCAST_CRASH_POINT(C_erased);
    drained(key, generation);
  }
}

}  // namespace agnocast
