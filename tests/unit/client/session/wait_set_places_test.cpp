// SPDX-License-Identifier: Apache-2.0
//
// Goal: a wait set gets one place in a session, places and numbers are reused, and none is lost.
// Method: wait sets of this process, a page as the client region, and a function as the daemon.

#include <client/session/wait_set_places.hpp>

#include <agnocast/abi/client_region.hpp>

#include <gtest/gtest.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/socket.h>

#include <memory>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

DoorbellReceiver doorbells() {
  int pair[2];
  if (::socketpair(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, pair) != 0) std::abort();
  ::close(pair[0]);
  return {UniqueFd(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)), UniqueFd(pair[1])};
}

struct WaitSetPlacesTest : testing::Test {
  struct Asked {
    std::uint64_t wait_set;
    bool again;
    friend bool operator==(const Asked&, const Asked&) = default;
  };

  WaitSetPlacesTest()
      : region(static_cast<std::byte*>(::mmap(nullptr, abi::page_bytes, PROT_READ | PROT_WRITE,
                                              MAP_SHARED | MAP_ANONYMOUS, -1, 0))) {}
  ~WaitSetPlacesTest() override { ::munmap(region, abi::page_bytes); }

  std::shared_ptr<WaitSet> wait_set() { return WaitSet::make().value(); }
  Result<void> give(WaitSet& to) {
    return places.give(
        to, this, [&] { return permit; },
        [&](std::uint64_t wait_set, bool again) -> Result<std::unique_ptr<WaitSet::Place>> {
          asked.push_back({wait_set, again});
          if (refuses) return fail(Errc::daemon_not_running, "it is away");
          return std::make_unique<WaitSet::Place>(region, wait_set, doorbells());
        });
  }

  std::byte* const region;
  Result<void> permit;
  bool refuses = false;
  std::vector<Asked> asked;
  WaitSetPlaces places;
};

TEST_F(WaitSetPlacesTest, GivesAWaitSetOnePlace) {
  const auto one = wait_set(), other = wait_set();
  ASSERT_TRUE(give(*one));
  ASSERT_TRUE(give(*one));
  ASSERT_TRUE(give(*other));
  EXPECT_EQ(asked, (std::vector<Asked>{{0, false}, {1, false}}));
  EXPECT_EQ(one->index_in(this), 0u);
  EXPECT_EQ(other->index_in(this), 1u);
}

TEST_F(WaitSetPlacesTest, ReusesReturnedPlaces) {
  auto one = wait_set();
  ASSERT_TRUE(give(*one));
  EXPECT_FALSE(places.end()) << "it is lent";
  one.reset();
  const auto next = wait_set();
  ASSERT_TRUE(give(*next));
  EXPECT_EQ(next->index_in(this), 0u);
  EXPECT_EQ(asked.size(), 1u) << "the daemon is not asked again";
  next->remove(this);
  EXPECT_TRUE(places.end());
}

TEST_F(WaitSetPlacesTest, AsksAgainForANumberWhoseDoorbellsDidNotCome) {
  const auto one = wait_set();
  refuses = true;
  const Result<void> refused = give(*one);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::daemon_not_running);
  EXPECT_EQ(one->index_in(this), std::nullopt);
  refuses = false;
  ASSERT_TRUE(give(*one));
  EXPECT_EQ(asked, (std::vector<Asked>{{0, false}, {0, true}}));
  const auto other = wait_set();
  ASSERT_TRUE(give(*other));
  EXPECT_EQ(other->index_in(this), 1u);
}

TEST_F(WaitSetPlacesTest, GivesNoPlaceWithoutPermission) {
  permit = fail(Errc::started_anew, "lost");
  const auto one = wait_set();
  const Result<void> refused = give(*one);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::started_anew);
  EXPECT_TRUE(asked.empty());
}

TEST_F(WaitSetPlacesTest, HasAsManyPlacesAsTheClientRegion) {
  std::vector<std::shared_ptr<WaitSet>> all;
  for (std::uint64_t i = 0; i < abi::wait_set_count_max; ++i) {
    all.push_back(wait_set());
    ASSERT_TRUE(give(*all.back())) << i;
  }
  const auto more = wait_set();
  const Result<void> refused = give(*more);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::limit_reached);
  all[7].reset();
  ASSERT_TRUE(give(*more));
  EXPECT_EQ(more->index_in(this), 7u);
}

TEST_F(WaitSetPlacesTest, RenewsTheDoorbellsOfAnUnusedPlace) {
  auto one = wait_set();
  ASSERT_TRUE(give(*one));
  DoorbellReceiver others = doorbells();
  const int fresh = others.eventfd();
  places.renew(0, others);
  EXPECT_EQ(others.eventfd(), fresh) << "it is lent: its wait set renews it";
  one.reset();
  places.renew(1, others);
  EXPECT_EQ(others.eventfd(), fresh) << "there is no such place";
  places.renew(0, others);
  EXPECT_NE(others.eventfd(), fresh);
  const auto next = wait_set();
  ASSERT_TRUE(give(*next));
  EXPECT_EQ(next->index_in(this), 0u);
}

}  // namespace
}  // namespace agnocast
