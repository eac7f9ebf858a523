// SPDX-License-Identifier: Apache-2.0
//
// EndpointTable: the endpoints that this process has in one session, by their places on the board.
//
// An endpoint is added in the control thread, by the answer to its creation, before the daemon can
// say anything of it, and is taken out only there. So a reference that the control thread has found
// stays good until it takes the endpoint out itself. Any thread may look.
//
// The mutex is not held while a publisher scans: scans destroy messages, and destructors are user
// code. Subscriptions run no user code, so the control thread may go over them under it.
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
  /// Tells all of them.
  void tell(const ConnectionInfo& info) const noexcept;

  // --- control thread

  void add(const std::shared_ptr<PublisherEndpoint>& publisher);
  void add(const std::shared_ptr<SubscriptionEndpoint>& subscription);
  void erase(const PublisherEndpoint& publisher) noexcept;
  void erase(const SubscriptionEndpoint& subscription) noexcept;

  /// Null: it is not here, or is of another generation.
  std::shared_ptr<PublisherEndpoint> publisher(const Key& key,
                                               std::uint64_t generation) const noexcept;
  std::shared_ptr<SubscriptionEndpoint> subscription(const Key& key,
                                                     std::uint64_t generation) const noexcept;
  /// Of an endpoint, until it is taken out; null: it is not here, or is of another generation.
  Departure* departure_of(Kind kind, const Key& key, std::uint64_t generation) const noexcept;
  /// Is one here, of whatever generation?
  bool is_here(Kind kind, const Key& key) const noexcept;
  /// Is any subscription linked to this publisher of its topic?
  bool is_linked(std::uint32_t topic, std::uint64_t publisher,
                 std::uint64_t generation) const noexcept;
  /// Is any publisher attached to this subscription of its topic? Allocates.
  bool is_attached(std::uint32_t topic, std::uint64_t subscription, std::uint64_t generation) const;

  /// `work` of each, under the mutex: it must not come back here.
  template <class Work>
  void for_each_subscription(Work work) const {
    const std::lock_guard lock(mutex_);
    for (const auto& [key, subscription] : subscriptions_) work(key, subscription);
  }
  /// Wait sets look around: something is there that rings nobody.
  void wake_wait_sets() const noexcept;
  /// The session was revoked: nobody is matched any more.
  void revoke() const noexcept;
  /// There is no daemon any more that could say more of the session.
  void be_alone() const noexcept;

  using Unlinked = std::function<void(std::uint32_t topic, const Link&)>;
  using Drained = std::function<void(const Key&, std::uint64_t generation)>;
  /// Unlinks what subscriptions are done with, and takes out those that have left and have no link
  /// any more. `unlinked` is told of publishers to which no subscription of this process is linked
  /// any more, `drained` of whom was taken out. Both under the mutex.
  void collect_subscriptions(const Unlinked& unlinked, const Drained& drained);

 private:
  mutable std::mutex mutex_;
  std::map<Key, std::shared_ptr<PublisherEndpoint>> publishers_;
  std::map<Key, std::shared_ptr<SubscriptionEndpoint>> subscriptions_;
};

}  // namespace agnocast
