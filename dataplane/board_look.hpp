// SPDX-License-Identifier: Apache-2.0
//
// Looks at the endpoints of a topic on the board: the daemon writes an endpoint there before it
// answers its creation, so what is counted here is true at once, whether the processes have mapped
// each other or not. For any thread; nothing waits or allocates.
#pragma once

#include <region/views.hpp>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>

namespace agnocast::dataplane {

struct BoardEndpoint {
  std::uint64_t generation;
  abi::QosOf of;
};

/// Returns the endpoint whose words field(offset) loads with acquire; nothing if none is active
/// there, or the place changed meanwhile.
template <class Entry, class Field>
std::optional<BoardEndpoint> active_endpoint(Field field) noexcept {
  const std::uint64_t word = field(offsetof(Entry, word));
  if (abi::state_of(word) != abi::BoardState::active) return std::nullopt;
  const BoardEndpoint found{
      abi::generation_of(word),
      {abi::unpack_qos({field(offsetof(Entry, policies)), field(offsetof(Entry, deadline_ns)), 0,
                        field(offsetof(Entry, lease_ns))}),
       field(offsetof(Entry, client))}};
  if (field(offsetof(Entry, word)) != word) return std::nullopt;
  return found;
}

template <class M>
std::optional<BoardEndpoint> active_publisher(const region::TopicWords<M>& topic,
                                              std::uint64_t index) noexcept {
  return active_endpoint<abi::PublisherEntry>([&](std::size_t offset) {
    return topic.publisher(index, offset).load(std::memory_order_acquire);
  });
}
template <class M>
std::optional<BoardEndpoint> active_subscription(const region::TopicWords<M>& topic,
                                                 std::uint64_t index) noexcept {
  return active_endpoint<abi::SubscriptionEntry>([&](std::size_t offset) {
    return topic.subscription(index, offset).load(std::memory_order_acquire);
  });
}

/// Counts the subscriptions that match `offered` and for which counts(index, endpoint) is true.
/// Costs a look at every place that was ever used, a cache line each.
template <class M, class Counts>
std::size_t matching_subscriptions(const region::TopicWords<M>& topic, const abi::QosOf& offered,
                                   Counts counts) noexcept {
  const std::uint64_t high = topic.subscription_high().load(std::memory_order_acquire);
  std::size_t count = 0;
  for (std::uint64_t i = 0; i < std::min<std::uint64_t>(high, abi::subscription_count_max); ++i) {
    const auto found = active_subscription(topic, i);
    count += found && abi::endpoints_match(offered, found->of) && counts(i, *found);
  }
  return count;
}
/// Counts the publishers that match `requested`. Costs as above.
template <class M>
std::size_t matching_publishers(const region::TopicWords<M>& topic,
                                const abi::QosOf& requested) noexcept {
  const std::uint64_t high = topic.publisher_high().load(std::memory_order_acquire);
  std::size_t count = 0;
  for (std::uint64_t i = 0; i < std::min<std::uint64_t>(high, M::publisher_count()); ++i) {
    const auto found = active_publisher(topic, i);
    count += found && abi::endpoints_match(found->of, requested);
  }
  return count;
}

}  // namespace agnocast::dataplane
