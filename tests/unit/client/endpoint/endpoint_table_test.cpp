// SPDX-License-Identifier: Apache-2.0
//
// Goal: the table finds endpoints by place and generation, and removes ended ones before they are
// reported. Method: endpoints over memory of this process, without any other process.

#include <client/endpoint/endpoint_table.hpp>

#include <agnocast/abi/board.hpp>

#include <gtest/gtest.h>
#include <sys/epoll.h>
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
  /// Links the subscription to a publisher of another process.
  void link(SubscriptionEndpoint& subscription, std::uint64_t publisher, std::uint64_t generation) {
    subscription.identity()
        .topic.publisher(publisher, offsetof(abi::PublisherEntry, word))
        .store(abi::pack_board_word(generation, abi::BoardState::active));
    SubscriptionEndpoint::Publisher announced{};
    announced.index = publisher;
    announced.generation = generation;
    announced.extent = next_extent();
    EXPECT_TRUE(subscription.add_publisher(announced, peer));
  }
  std::vector<Key> collect() {
    std::vector<Key> all;
    table.collect_subscriptions(
        [&](std::uint32_t topic, const Link& of) { unlinked.emplace_back(topic, of.publisher()); },
        [&](const Key& key, std::uint64_t) { all.push_back(key); });
    return all;
  }

  std::byte* const board = memory(abi::board_bytes);
  std::byte* const region = memory(region_bytes);
  std::uint64_t extents = 0;
  const std::shared_ptr<Peer> peer = std::make_shared<Peer>(9, 90, region);
  std::vector<Key> unlinked;  // reported by collect(): topic and publisher
  EndpointTable table;
};

TEST_F(EndpointTableTest, FindsEndpointsByPlaceAndGeneration) {
  EXPECT_TRUE(table.is_empty());
  const auto publisher = add_publisher({1, 2}, 7);
  EXPECT_FALSE(table.is_empty());
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
  EXPECT_EQ(table.subscription({1, 0}, 1), nullptr);
  EXPECT_EQ(table.subscriptions(), std::vector{here});
  EXPECT_TRUE(collect().empty());
  EXPECT_TRUE(unlinked.empty());
}

TEST_F(EndpointTableTest, ReportsARemovedSubscriptionWhenNothingOfItIsLeft) {
  auto gone = add_subscription({1, 0}, 1);
  gone->close();
  gone->departure().want();
  gone->departure().known();
  const std::weak_ptr left = gone;
  gone.reset();
  bool was_reported = false;
  table.collect_subscriptions([](std::uint32_t, const Link&) {},
                              [&](const Key&, std::uint64_t generation) {
                                was_reported = true;
                                EXPECT_EQ(generation, 1u);
                                EXPECT_TRUE(left.expired());
                              });
  EXPECT_TRUE(was_reported);
}

TEST_F(EndpointTableTest, ReportsAnUnlinkedPublisherWithTheLastOfItsSubscriptions) {
  const auto one = add_subscription({1, 0}, 1), two = add_subscription({1, 1}, 2),
             elsewhere = add_subscription({2, 0}, 3);
  for (const auto& subscription : {one, two, elsewhere}) link(*subscription, 5, 50);
  EXPECT_TRUE(table.is_linked(1, 5, 50));
  EXPECT_FALSE(table.is_linked(3, 5, 50)) << "another topic";
  EXPECT_FALSE(table.is_linked(1, 5, 51)) << "another generation";
  const auto leave = [](SubscriptionEndpoint& subscription) {
    subscription.close();
    subscription.departure().want();
    subscription.departure().known();
  };
  leave(*one);
  EXPECT_EQ(collect(), (std::vector{Key{1, 0}}));
  EXPECT_TRUE(unlinked.empty()) << "another subscription is linked to it";
  leave(*two);
  EXPECT_EQ(collect(), (std::vector{Key{1, 1}}));
  EXPECT_EQ(unlinked, (std::vector{Key{1, 5}}));
  EXPECT_FALSE(table.is_linked(1, 5, 50));
  EXPECT_TRUE(table.is_linked(2, 5, 50));
}

TEST_F(EndpointTableTest, PassesOnWhatConcernsAllEndpoints) {
  const auto publisher = add_publisher({1, 0}, 1);
  const auto one = add_subscription({1, 0}, 2), other = add_subscription({2, 0}, 3);
  link(*one, 5, 50);
  link(*other, 5, 51);
  detail::EventCallbacks callbacks;
  callbacks.connection = [](ConnectionInfo&) {};
  const auto wait_set = WaitSet::make().value();
  std::vector<EndpointEvents*> events{&publisher->events(), &one->events(), &other->events()};
  for (EndpointEvents* const of : events) of->wake_for(callbacks, wait_set);
  table.tell(ConnectionInfo{});
  for (EndpointEvents* const of : events) EXPECT_TRUE(of->has_pending());

  const UniqueFd epoll(::epoll_create1(EPOLL_CLOEXEC));
  ASSERT_TRUE(other->shared_wait_set()->add_to(epoll.get(), 1, 2));
  const auto is_woken = [&] {
    epoll_event event{};
    return ::epoll_wait(epoll.get(), &event, 1, 0) == 1;
  };
  static_cast<void>(is_woken());  // the link has woken it
  EXPECT_FALSE(is_woken());
  table.wake_wait_sets();
  EXPECT_TRUE(is_woken());

  EXPECT_EQ(one->events().matched_status().current_count, 1u);
  table.revoke();
  for (const auto& subscription : {one, other})
    EXPECT_EQ(subscription->events().matched_status().current_count, 0u);
}

}  // namespace
}  // namespace agnocast
