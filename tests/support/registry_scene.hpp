// SPDX-License-Identifier: Apache-2.0
//
// A registry with processes, publishers and subscriptions in it, and nothing else: no descriptor,
// no connection. For decisions that only read the registry.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <daemon/state/registry.hpp>
#include <tests/support/memory/registry_memory.hpp>

#include <cstdint>
#include <string>
#include <string_view>

namespace agnocast::test {

struct RegistryScene {
  explicit RegistryScene(const daemon::Capacity& capacity = {})
      : registry(memory.parts(), capacity) {
    registry.create(1);
  }

  daemon::ClientIndex process(std::uint32_t uid = 1000) {
    return registry.add_client({uid, uid, 4000, 0, "a process"}).value();
  }
  daemon::TopicIndex topic(std::string_view name) {
    if (const auto known = registry.find_topic(0, name)) return *known;
    return registry.add_topic({0, name, "pkg/msg/Type", 5}).value();
  }
  daemon::EndpointRef publisher(daemon::ClientIndex owner, std::string_view name = "/topic") {
    const daemon::TopicIndex at = topic(name);
    const auto plan = registry.plan_publisher(owner, at, qos).value();
    registry.add_publisher(owner, at, qos, plan, "node");
    return {daemon::Kind::publisher, at, plan.index};
  }
  daemon::EndpointRef subscription(daemon::ClientIndex owner, std::string_view name = "/topic") {
    const daemon::TopicIndex at = topic(name);
    const auto plan = registry.plan_subscription(owner, at, qos, {1, 1}).value();
    for (const daemon::SlotRaise& raise : plan.raises) registry.raise_slots(at, raise);
    registry.add_subscription(owner, at, qos, {1, 1}, 0, plan, "node");
    return {daemon::Kind::subscription, at, plan.index};
  }
  /// As the packet would say it.
  abi::wire::Reference reference(const daemon::EndpointRef& ref) const {
    abi::wire::Reference packet{};
    packet.kind = ref.kind;
    packet.topic = number(ref.topic);
    packet.index = ref.index;
    packet.generation = registry.generation_of(ref);
    return packet;
  }
  void orphan(const daemon::EndpointRef& ref) {
    registry.orphan_publisher(ref.topic, ref.index, 0, journal::LeaveCause::left);
  }
  std::uint64_t records() { return registry.log().committed_lsn(); }

  static constexpr abi::Qos qos{1, false, true, false, false};
  RegistryMemory memory;
  daemon::Registry registry;
};

/// Counts the effects of one type.
template <class Kind, class Effects>
std::size_t count_of(const Effects& effects) {
  std::size_t count = 0;
  for (const auto& one : effects) count += std::holds_alternative<Kind>(one);
  return count;
}

}  // namespace agnocast::test
