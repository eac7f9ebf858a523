// SPDX-License-Identifier: Apache-2.0
//
// Table checks: see the header.

#include <tests/fuzz/protocol/table_checks.hpp>

#include <base/check.hpp>

#include <algorithm>
#include <cstdint>
#include <tuple>

namespace agnocast::daemon::fuzz {

namespace {

abi::BoardState as_publisher(EndpointState state) {
  return state == EndpointState::active   ? abi::BoardState::active
         : state == EndpointState::orphan ? abi::BoardState::orphan
                                          : abi::BoardState::free;
}

abi::BoardState as_subscription(EndpointState state) {
  return state == EndpointState::active    ? abi::BoardState::active
         : state == EndpointState::leaving ? abi::BoardState::leaving
         : state == EndpointState::dead    ? abi::BoardState::dead
                                           : abi::BoardState::free;
}

}  // namespace

void check_board(const Registry& registry, const Registry::Memory& memory) {
  for (std::uint32_t t = 0; t < registry.topic_high(); ++t) {
    const TopicIndex topic{t};
    if (registry.topic(topic).state == TopicState::free) continue;
    const region::TopicWords<SharedMemory> words{memory.board, abi::topic_offset(t)};
    for (std::uint32_t i = 0; i < registry.topic(topic).publisher_high; ++i) {
      const PublisherRecord& record = registry.publisher(topic, i);
      const std::uint64_t word = words.publisher(i, 0).load();
      AGNOCAST_CHECK(abi::state_of(word) == as_publisher(record.state));
      AGNOCAST_CHECK(record.state == EndpointState::free ||
                     abi::generation_of(word) == record.generation);
    }
    for (std::uint32_t i = 0; i < registry.topic(topic).subscription_high; ++i) {
      const SubscriptionRecord& record = registry.subscription(topic, i);
      AGNOCAST_CHECK(abi::state_of(words.subscription(i, 0).load()) ==
                     as_subscription(record.state));
    }
  }
}

void check_restart(const Registry& registry, const Registry::Memory& memory) {
  Registry later(memory, registry.capacity());
  AGNOCAST_CHECK(static_cast<bool>(later.open()));
  for (std::uint32_t c = 0; c < registry.client_high(); ++c) {
    auto before = registry.endpoints_of(ClientIndex{c}), after = later.endpoints_of(ClientIndex{c});
    const auto less = [](const EndpointRef& a, const EndpointRef& b) {
      return std::tuple(a.kind, a.topic, a.index) < std::tuple(b.kind, b.topic, b.index);
    };
    std::sort(before.begin(), before.end(), less);
    std::sort(after.begin(), after.end(), less);
    AGNOCAST_CHECK(before == after);
  }
}

void check_nothing_left(const Registry& registry, const AddressPlan& plan) {
  for (std::uint32_t c = 0; c < registry.client_high(); ++c)
    AGNOCAST_CHECK(registry.client(ClientIndex{c}).state == ClientState::free);
  for (std::uint32_t t = 0; t < registry.topic_high(); ++t)
    AGNOCAST_CHECK(registry.topic(TopicIndex{t}).state == TopicState::free);
  AGNOCAST_CHECK(plan.used_count() == 0);
}

}  // namespace agnocast::daemon::fuzz
