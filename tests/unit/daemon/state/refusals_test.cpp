// SPDX-License-Identifier: Apache-2.0
//
// Goal: recent refusals are kept, in bounded number, and no user displaces the refusals of others.
// Method: refusals as values.

#include <daemon/state/refusals.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <string>

namespace agnocast::daemon {
namespace {

Refusals::Refusal refusal(std::uint32_t uid, std::uint32_t pid, const std::string& topic = "/a") {
  Refusals::Refusal one;
  one.code = Errc::type_mismatch;
  one.uid = uid;
  one.pid = pid;
  one.topic = topic;
  return one;
}

TEST(Refusals, CountRepetitions) {
  Refusals refusals;
  refusals.add(refusal(1, 10));
  refusals.add(refusal(1, 10, "/b"));
  Refusals::Refusal again = refusal(1, 10);
  again.stamp_ns = 7;
  again.why = "now";
  refusals.add(again);
  ASSERT_EQ(refusals.all().size(), 2u);
  EXPECT_EQ(refusals.all()[0].topic, "/b") << "the newest is the last";
  EXPECT_EQ(refusals.all()[1].times, 2u);
  EXPECT_EQ(refusals.all()[1].stamp_ns, 7u);
  EXPECT_EQ(refusals.all()[1].why, "now");
}

TEST(Refusals, KeepTheRefusalsOfOthersWhenOneUserFloods) {
  Refusals refusals;
  refusals.add(refusal(1, 10));
  refusals.add(refusal(2, 20));
  for (std::uint32_t i = 0; i < 10 * Refusals::count_max; ++i) refusals.add(refusal(3, i));
  EXPECT_EQ(refusals.all().size(), Refusals::count_max);
  const auto has = [&](std::uint32_t uid, std::uint32_t pid) {
    return std::any_of(refusals.all().begin(), refusals.all().end(),
                       [&](const auto& one) { return one.uid == uid && one.pid == pid; });
  };
  EXPECT_TRUE(has(1, 10));
  EXPECT_TRUE(has(2, 20));
  EXPECT_TRUE(has(3, 10 * Refusals::count_max - 1))
      << "a user's newest refusal replaces its oldest";
  EXPECT_FALSE(has(3, 0));
}

}  // namespace
}  // namespace agnocast::daemon
