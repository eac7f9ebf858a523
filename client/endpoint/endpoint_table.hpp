// SPDX-License-Identifier: Apache-2.0
//
// EndpointTable: the endpoints of this process in one session, by their places on the board.
//
// The control thread adds an endpoint with the answer to its creation, before the daemon can send
// anything about it, and only the control thread removes it. So a reference found by the control
// thread stays valid until that thread removes the endpoint itself. Any thread may read.
//
// The mutex is not held while a publisher scans: scans destroy messages, and destructors are user
// code. Subscriptions run no user code, so the control thread may visit them under the mutex.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <agnocast/connection_state.hpp>
#include <client/endpoint/departure.hpp>
#include <client/endpoint/publisher_endpoint.hpp>
#include <client/endpoint/subscription_endpoint.hpp>

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

namespace agnocast {

class EndpointTable {
 public:
  using Kind = abi::wire::Kind;
  using Key = std::pair<std::uint32_t, std::uint64_t>;  // topic, index

  // --- any thread

  std::vector<std::shared_ptr<PublisherEndpoint>> publishers() const;
  std::vector<std::shared_ptr<SubscriptionEndpoint>> subscriptions() const;
  bool is_empty() const noexcept;
  /// Passes the connection state to all endpoints.
  void tell(const ConnectionInfo& info) const noexcept;

  // --- control thread

  void add(const std::shared_ptr<PublisherEndpoint>& publisher);
  void add(const std::shared_ptr<SubscriptionEndpoint>& subscription);
  void erase(const PublisherEndpoint& publisher) noexcept;
  void erase(const SubscriptionEndpoint& subscription) noexcept;

  /// Returns null if the endpoint is not here, or has another generation.
  std::shared_ptr<PublisherEndpoint> publisher(const Key& key,
                                               std::uint64_t generation) const noexcept;
  std::shared_ptr<SubscriptionEndpoint> subscription(const Key& key,
                                                     std::uint64_t generation) const noexcept;
  /// Returns the departure of an endpoint, valid until the endpoint is removed; null as above.
  Departure* departure_of(Kind kind, const Key& key, std::uint64_t generation) const noexcept;
  /// Returns whether any subscription is linked to this publisher of its topic.
  bool is_linked(std::uint32_t topic, std::uint64_t publisher,
                 std::uint64_t generation) const noexcept;
  /// Returns whether any publisher is attached to this subscription of its topic. Allocates.
  bool is_attached(std::uint32_t topic, std::uint64_t subscription, std::uint64_t generation) const;

  /// Calls `work` for each, under the mutex: it must not call this table.
  template <class Work>
  void for_each_subscription(Work work) const {
    const std::lock_guard lock(mutex_);
    for (const auto& [key, subscription] : subscriptions_) work(key, subscription);
  }
  /// Wakes all wait sets, after a change that rings no doorbell.
  void wake_wait_sets() const noexcept;
  /// The session was revoked: ends all matches.
  void revoke() const noexcept;
  /// The session's daemon will not come back.
  void be_alone() const noexcept;

  using Unlinked = std::function<void(std::uint32_t topic, const Link&)>;
  using Drained = std::function<void(const Key&, std::uint64_t generation)>;
  /// Unlinks the links that subscriptions no longer need, and removes subscriptions that have left
  /// and have no link. Calls `unlinked` for each publisher that no subscription of this process is
  /// linked to any more, and `drained` for each removed subscription; both under the mutex.
  void collect_subscriptions(const Unlinked& unlinked, const Drained& drained);

 private:
  mutable std::mutex mutex_;
  std::map<Key, std::shared_ptr<PublisherEndpoint>> publishers_;
  std::map<Key, std::shared_ptr<SubscriptionEndpoint>> subscriptions_;
};

}  // namespace agnocast
