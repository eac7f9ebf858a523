// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever users ask for, in any order, a publisher never lacks a slot because of others:
// their holds, a history of the greatest depth and the messages in hand fit into its slots; late
// users get something too. Method: users of the pool alone, the greediest and random ones
// (seeded), and the registry with publishers of every user, over many incarnations of the daemon.

#include <daemon/state/hold_pool.hpp>
#include <daemon/state/registry.hpp>
#include <tests/support/memory/registry_memory.hpp>

#include <gtest/gtest.h>

#include <map>
#include <memory>
#include <random>
#include <vector>

namespace agnocast::daemon {
namespace {

constexpr HoldPool usual(2048, 1000, 768);  // has 245 messages

/// Lets user after user take all it can. Returns what each got beyond the one.
std::vector<std::uint64_t> greediest(const HoldPool& pool, std::size_t users) {
  std::vector<std::uint64_t> got;
  std::uint64_t others = 0;
  for (std::size_t user = 0; user < users; ++user) {
    got.push_back(pool.at_most({0, others}) - 1);
    EXPECT_EQ(pool.at_most({got.back(), others}), 1u) << "no more, but always the one";
    others += got.back();
  }
  return got;
}

TEST(HoldPool, LeavesHalfOfTheRestToLaterUsers) {
  EXPECT_EQ(greediest(usual, 9), (std::vector<std::uint64_t>{122, 61, 31, 15, 8, 4, 2, 1, 0}));
}

TEST(HoldPool, GivesNothingTwice) {
  for (const std::uint64_t slots : {40u, 500u, 1803u, 1804u, 1805u, 2048u}) {
    const HoldPool pool(slots, 100, 300);
    std::uint64_t sum = 0;
    for (const std::uint64_t one : greediest(pool, 50)) sum += one;
    EXPECT_LE(sum, pool.size()) << slots;
  }
  EXPECT_EQ(HoldPool(1, 1000, 768).size(), 0u);
  EXPECT_EQ(HoldPool(1, 1000, 768).at_most({0, 0}), 1u);
}

TEST(HoldPool, HasAPartForDozensOfSubscriptionsWithoutANumber) {
  std::uint64_t used = 0, several = 0, first = 0;
  for (int i = 0; i < 128; ++i) {
    const std::uint64_t part = usual.part({used, 0}, 64);
    ASSERT_GE(part, 1u);
    if (i == 0) first = part;
    several += part > 1 ? 1 : 0;
    used += part - 1;
  }
  EXPECT_EQ(first, 17u);
  EXPECT_GT(several, 24u);
  EXPECT_EQ(usual.part({0, 0}, 4), 4u) << "never more than requested";
  EXPECT_LE(used, usual.size() / 2);
}

TEST(HoldPool, RegainsTheHoldsOfEndedSubscriptions) {
  EXPECT_EQ(usual.at_most({122, 0}), 1u);
  EXPECT_EQ(usual.at_most({22, 0}), 101u);
  EXPECT_EQ(usual.at_most({0, 122}), 62u);
  // Another user came first and is gone: this user's holds are within its share, or beyond it.
  EXPECT_EQ(usual.at_most({200, 0}), 1u);
  EXPECT_EQ(usual.at_most({0, 10'000}), 1u);
}

// Users come and go, processes and daemons die. Each user has a publisher in each look, with the
// depth and kind that needs most.
TEST(HoldPool, NoPublisherOfAnyUserLosesTooManySlotsToOthers) {
  test::RegistryMemory memory;
  auto registry = std::make_unique<Registry>(memory.parts());
  registry->create(1);
  const TopicIndex topic = registry->add_topic({0, "/topic", "T", 1}).value();
  std::mt19937 random(20261123);
  std::vector<ClientIndex> clients;
  for (std::uint32_t i = 0; i < 12; ++i)
    clients.push_back(registry->add_client({i / 2, 0, 1, 0, "process"}).value());
  std::vector<std::uint32_t> there;
  const abi::Qos qos{abi::depth_max, true, true, true, false};
  std::uint64_t fullest = 0;
  for (int step = 0; step < 6000; ++step) {
    const bool ends = !there.empty() && random() % (step % 2000 < 1200 ? 20 : 2) == 0;
    if (ends) {
      const std::size_t at = random() % there.size();
      registry->change_subscription(topic, there[at], EndpointState::over);
      registry->free_subscription(topic, there[at]);
      there.erase(there.begin() + static_cast<std::ptrdiff_t>(at));
    } else if (there.size() < abi::subscription_count_max) {
      const ClientIndex client = clients[random() % clients.size()];
      const HoldPool::Use use = registry->pool_use(registry->client(client).uid, topic);
      const std::uint64_t asked = 1 + random() % 2048;
      const HoldPool pool = registry->hold_pool();
      const HoldQuota quota{
          asked, random() % 4 == 0 ? std::min(asked, pool.at_most(use)) : pool.part(use, asked)};
      const auto plan = registry->plan_subscription(client, topic, qos, quota);
      ASSERT_TRUE(plan);
      registry->add_subscription(client, topic, qos, quota, 0, *plan, "node");
      there.push_back(plan->index);
    }
    if (step % 50 == 0) {
      registry = std::make_unique<Registry>(memory.parts());
      ASSERT_TRUE(registry->open());
    }
    std::map<std::uint32_t, std::uint64_t> of_user;
    std::uint64_t all = 0;
    registry->for_each_subscription(topic, [&](std::uint32_t, const SubscriptionRecord& record) {
      of_user[registry->client(record.client).uid] += record.quota_of_others;
      all += record.quota_of_others;
    });
    for (std::uint32_t uid = 0; uid < 6; ++uid) {
      const std::uint64_t of_others = all - of_user[uid];
      fullest = std::max(fullest, of_others);
      ASSERT_LE(abi::depth_max + slots_beside_history + of_others, abi::slot_count_max)
          << "step " << step << " user " << uid;
    }
    if (step % 500 == 0) {
      for (const ClientIndex client : clients)
        ASSERT_GE(registry->plan_publisher(client, topic, qos).value().slot_count,
                  std::min<std::uint64_t>(abi::slot_count_max,
                                          abi::depth_max + slots_beside_history + all -
                                              of_user[registry->client(client).uid]));
    }
  }
  EXPECT_GT(fullest, 1500u) << "the pool was never nearly full";
}

}  // namespace
}  // namespace agnocast::daemon
