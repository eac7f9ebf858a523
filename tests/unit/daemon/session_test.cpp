// SPDX-License-Identifier: Apache-2.0
//
// Goal: what a session remembers of what its process was told says so, and has a bound. Method: the books
// alone, without a socket.

#include <daemon/session.hpp>

#include <gtest/gtest.h>

namespace agnocast::daemon {
namespace {

using abi::wire::Kind;

constexpr Announced publisher{Kind::publisher, 1, 2};
constexpr Announced subscription(std::uint64_t index) { return {Kind::subscription, 1, index}; }

TEST(CollisionsTold, IsNewsOnceForEachPairAndWhenSomethingOfItIsAnother) {
  CollisionsTold told;
  const CollisionsTold::Collision what{10, 20, 0, true};
  EXPECT_TRUE(told.tell(publisher, subscription(0), what));
  EXPECT_FALSE(told.tell(publisher, subscription(0), what));
  EXPECT_TRUE(told.tell(publisher, subscription(1), what));
  EXPECT_FALSE(told.tell(publisher, subscription(0), what));
  for (const CollisionsTold::Collision& other :
       {CollisionsTold::Collision{11, 20, 0, true}, CollisionsTold::Collision{11, 21, 0, true},
        CollisionsTold::Collision{11, 21, 1, true}, CollisionsTold::Collision{11, 21, 1, false}}) {
    EXPECT_TRUE(told.tell(publisher, subscription(0), other));
    EXPECT_FALSE(told.tell(publisher, subscription(0), other));
  }
}

TEST(CollisionsTold, HasABoundHoweverManyPairsCollide) {
  CollisionsTold told;
  const CollisionsTold::Collision what{10, 20, 0, true};
  for (std::uint64_t i = 0; i < 3 * CollisionsTold::count_max; ++i) {
    EXPECT_TRUE(told.tell(publisher, subscription(i), what));
    EXPECT_FALSE(told.tell(publisher, subscription(i), what)) << "just told";
    ASSERT_LE(told.size(), CollisionsTold::count_max);
  }
}

}  // namespace
}  // namespace agnocast::daemon
