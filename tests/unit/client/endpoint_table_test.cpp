// SPDX-License-Identifier: Apache-2.0
//
// Goal: the table finds endpoints by place and generation, and removes ended ones before they are
// reported. Method: endpoints over memory of this process, without any other process.

#include <client/endpoint/endpoint_table.hpp>

#include <agnocast/abi/board.hpp>

#include <gtest/gtest.h>
#include <sys/mman.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

namespace agnocast {
namespace {

using Kind = EndpointTable::Kind;
using Key = EndpointTable::Key;

constexpr std::uint64_t region_bytes = std::uint64_t{64} << 20;

std::byte* memory(std::uint64_t bytes) {
  return static_cast<std::byte*>(::mmap(nullptr, bytes, PROT_READ | PROT_WRITE,
                                        MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0));
}

struct EndpointTableTest : testing::Test {
  ~EndpointTableTest() override {
    ::munmap(board, abi::board_bytes);
    ::munmap(region, region_bytes);
  }

  std::uint64_t next_extent() { return extents += std::uint64_t{1} << 20; }
  std::shared_ptr<PublisherEndpoint> add_publisher(const Key& key, std::uint64_t generation) {
    const PublisherEndpoint::Core::Identity core{{board, abi::topic_offset(key.first)},
                                                 {region, next_extent()},
                                                 key.second,
                                                 generation,
                                                 0,
                                                 abi::Qos{},
                                                 abi::slot_count_max,
                                                 0};
    auto made = std::make_shared<PublisherEndpoint>(
        PublisherEndpoint::Identity{core, key.first, detail::MessageEnd::of<int>(), [] {}});
    table.add(made);
    return made;
  }
  std::shared_ptr<SubscriptionEndpoint> add_subscription(const Key& key, std::uint64_t generation) {
    SubscriptionEndpoint::Identity identity{};
    identity.topic = {board, abi::topic_offset(key.first)};
    identity.topic_index = key.first;
    identity.index = key.second;
    identity.generation = generation;
    identity.region = region;
    identity.extent = next_extent();
    auto made = std::make_shared<SubscriptionEndpoint>(identity, WaitSet::make().value());
    table.add(made);
    return made;
  }
  std::vector<Key> collect() {
    std::vector<Key> all;
    table.collect_subscriptions(
        [](std::uint32_t, const Link&) { FAIL() << "no subscription was linked"; },
        [&](const Key& key, std::uint64_t) { all.push_back(key); });
    return all;
  }

  std::byte* const board = memory(abi::board_bytes);
  std::byte* const region = memory(region_bytes);
  std::uint64_t extents = 0;
  EndpointTable table;
};

TEST_F(EndpointTableTest, FindsEndpointsByPlaceAndGeneration) {
  EXPECT_TRUE(table.is_empty());
  const auto publisher = add_publisher({1, 2}, 7);
  const auto subscription = add_subscription({1, 2}, 8);
  EXPECT_FALSE(table.is_empty());
  EXPECT_EQ(table.publisher({1, 2}, 7), publisher);
  EXPECT_EQ(table.publisher({1, 2}, 8), nullptr);
  EXPECT_EQ(table.publisher({2, 1}, 7), nullptr);
  EXPECT_EQ(table.subscription({1, 2}, 8), subscription);
  EXPECT_EQ(table.subscription({1, 2}, 7), nullptr);
  EXPECT_EQ(table.departure_of(Kind::publisher, {1, 2}, 7), &publisher->departure());
  EXPECT_EQ(table.departure_of(Kind::subscription, {1, 2}, 8), &subscription->departure());
  EXPECT_EQ(table.departure_of(Kind::subscription, {1, 2}, 7), nullptr);
  EXPECT_EQ(table.departure_of(Kind::region, {1, 2}, 7), nullptr);
  EXPECT_TRUE(table.is_here(Kind::publisher, {1, 2}));
  EXPECT_FALSE(table.is_here(Kind::publisher, {1, 3}));
  EXPECT_FALSE(table.is_linked(1, 2, 7));
  EXPECT_FALSE(table.is_attached(1, 2, 8));
}

TEST_F(EndpointTableTest, ListsAllEndpointsAndErasesTheGivenOnes) {
  const auto one = add_publisher({1, 0}, 1), other = add_publisher({2, 0}, 2);
  const auto subscription = add_subscription({1, 0}, 3);
  EXPECT_EQ(table.publishers(), (std::vector{one, other}));
  EXPECT_EQ(table.subscriptions(), std::vector{subscription});
  table.erase(*one);
  EXPECT_EQ(table.publishers(), std::vector{other});
  table.erase(*subscription);
  EXPECT_TRUE(table.subscriptions().empty());
}

TEST_F(EndpointTableTest, CollectsAClosedSubscriptionWhenTheDaemonKnows) {
  const auto gone = add_subscription({1, 0}, 1), here = add_subscription({1, 1}, 2);
  EXPECT_TRUE(collect().empty());
  gone->close();
  gone->departure().want();
  EXPECT_TRUE(collect().empty()) << "the daemon does not know yet";
  gone->departure().known();
  EXPECT_EQ(collect(), (std::vector{Key{1, 0}}));
  EXPECT_FALSE(table.is_here(Kind::subscription, {1, 0}));
  EXPECT_EQ(table.subscriptions(), std::vector{here});
  EXPECT_TRUE(collect().empty());
}

}  // namespace
}  // namespace agnocast
