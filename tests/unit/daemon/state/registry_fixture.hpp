// SPDX-License-Identifier: Apache-2.0
//
// RegistryTest: a registry in its own memory, with queries for tests.
#pragma once

#include <agnocast/abi/fingerprint.hpp>
#include <daemon/state/registry.hpp>
#include <tests/support/memory/registry_memory.hpp>

#include <gtest/gtest.h>

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cstdio>
#include <cstring>
#include <map>
#include <random>
#include <set>

namespace agnocast::daemon {

using Memory = test::RegistryMemory;

class RegistryTest : public testing::Test {
 protected:
  RegistryTest() : registry(memory.parts()) { registry.create(1); }

  ClientIndex client(std::uint32_t uid = 1000) {
    return registry.add_client({uid, uid, 1, 0, "a process"}).value();
  }
  TopicIndex topic(std::string_view name = "/topic") {
    return registry.add_topic({0, name, "pkg/msg/Type", 5}).value();
  }
  PublisherPlan publisher(ClientIndex owner, TopicIndex at, std::uint32_t depth = 1) {
    const abi::Qos qos{depth, false, true, false, false};
    const PublisherPlan plan = registry.plan_publisher(owner, at, qos).value();
    registry.add_publisher(owner, at, qos, plan, "node");
    return plan;
  }
  SubscriptionPlan subscription(ClientIndex owner, TopicIndex at, std::uint32_t depth = 1,
                                std::uint64_t own_quota = 1, std::uint64_t quota_of_others = 1) {
    const abi::Qos qos{depth, false, true, false, false};
    const HoldQuota quota{own_quota, quota_of_others};
    const SubscriptionPlan plan = registry.plan_subscription(owner, at, qos, quota).value();
    for (const SlotRaise& raise : plan.raises) registry.raise_slots(at, raise);
    registry.add_subscription(owner, at, qos, quota, 0, plan, "node");
    return plan;
  }
  std::uint64_t board_word(TopicIndex at, std::uint64_t offset) const {
    return SharedMemory::word(memory.board(), abi::topic_offset(number(at)) + offset).load();
  }
  std::uint64_t publisher_word(TopicIndex at, std::uint32_t index) const {
    return board_word(at, abi::publisher_entry_offset(index));
  }
  std::uint64_t subscription_word(TopicIndex at, std::uint32_t index) const {
    return board_word(at, abi::subscription_entry_offset(abi::publisher_count_max, index));
  }

  Memory memory;
  Registry registry;
};

}  // namespace agnocast::daemon
