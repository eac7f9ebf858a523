// SPDX-License-Identifier: Apache-2.0
//
// Goal: users get time slices in turn, however many connections and packets one of them has.
// Method: connections are numbers, packets are counts, the clock is a variable.

#include <daemon/transport/fair_scheduler.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

namespace agnocast::daemon {
namespace {

struct Clock {
  std::uint64_t now = 1;
  auto function() {
    return [this] { return now; };
  }
};

using Served = std::vector<PeerId>;

TEST(FairScheduler, ServesConnectionsOfOneUserInTheirOrder) {
  FairScheduler scheduler;
  Clock clock;
  for (const PeerId id : Served{3, 1, 2}) scheduler.wait(1000, id);
  Served served;
  scheduler.serve(
      [&](PeerId id, const TimeSlice&) { return served.push_back(id), std::optional(1U); },
      clock.function());
  EXPECT_EQ(served, (Served{3, 1, 2}));
  EXPECT_TRUE(scheduler.nobody_waits());
}

TEST(FairScheduler, GivesAUserWithManyPacketsOneSliceAtATime) {
  FairScheduler scheduler;
  Clock clock;
  for (const PeerId id : Served{1, 2, 3}) scheduler.wait(1000, id);
  scheduler.wait(2000, 9);
  std::vector<std::pair<PeerId, unsigned>> served;
  const auto serve = [&](PeerId id, const TimeSlice& slice) {
    served.emplace_back(id, slice.packets_left);
    return std::optional(id == 9 ? 1U : TimeSlice::packets_max - 1);
  };
  scheduler.serve(serve, clock.function());
  // The first connection leaves one packet of the slice to the second; the third waits.
  const auto count_of = [&](PeerId id) {
    return std::count_if(served.begin(), served.end(),
                         [&](const auto& one) { return one.first == id; });
  };
  EXPECT_EQ(count_of(1) + count_of(2), 2);
  EXPECT_EQ(count_of(9), 1);
  EXPECT_EQ(count_of(3), 0);
  EXPECT_FALSE(scheduler.nobody_waits());
  scheduler.serve(serve, clock.function());
  EXPECT_EQ(served.back(), (std::pair<PeerId, unsigned>(3, TimeSlice::packets_max)));
  EXPECT_TRUE(scheduler.nobody_waits());
}

TEST(FairScheduler, EndsASliceWhenItsTimeIsOver) {
  FairScheduler scheduler;
  Clock clock;
  scheduler.wait(1000, 1);
  scheduler.wait(1000, 2);
  Served served;
  scheduler.serve(
      [&](PeerId id, const TimeSlice& slice) {
        served.push_back(id);
        EXPECT_EQ(slice.until_ns, 1 + TimeSlice::budget_ns);
        clock.now = slice.until_ns;
        return std::optional(1U);
      },
      clock.function());
  EXPECT_EQ(served, (Served{1}));
  EXPECT_FALSE(scheduler.nobody_waits());
}

TEST(FairScheduler, CountsAnIdleConnectionAsOnePacketAndAGoneOneAsNone) {
  FairScheduler scheduler;
  Clock clock;
  scheduler.wait(1000, 1);
  scheduler.wait(1000, 2);
  scheduler.wait(1000, 3);
  std::vector<unsigned> left;
  scheduler.serve(
      [&](PeerId id, const TimeSlice& slice) {
        left.push_back(slice.packets_left);
        return id == 1 ? std::nullopt : std::optional(0U);
      },
      clock.function());
  EXPECT_EQ(left, (std::vector<unsigned>{TimeSlice::packets_max, TimeSlice::packets_max,
                                         TimeSlice::packets_max - 1}));
}

}  // namespace
}  // namespace agnocast::daemon
