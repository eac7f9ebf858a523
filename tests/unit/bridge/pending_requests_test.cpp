// SPDX-License-Identifier: Apache-2.0
//
// Goal: a server has no more requests pending than it has room for answers, however long it does
// not answer. Method: time as a value, completions as pointers.

#include <bridge/services/pending_requests.hpp>

#include <gtest/gtest.h>

#include <map>
#include <memory>

namespace agnocast::bridge {
namespace {

class RequestsPending : public testing::Test {
 protected:
  /// Sends as many requests as there is room for now. Returns their count.
  std::size_t send() {
    std::size_t count = 0;
    for (; count <= PendingRequests::unanswered_max && pending_.has_room(now_); ++count) {
      const auto completion = std::make_shared<int>();
      completions_[++newest_] = completion;
      if (const auto oldest = pending_.add(newest_, completion, now_)) {
        EXPECT_EQ(*oldest, completions_.begin()->first) << "an older request exists";
        completions_.erase(*oldest);
        ++forgotten_;
      }
    }
    return count;
  }
  void answer(std::int64_t request) { completions_.erase(request); }
  void pass_time() { now_ += PendingRequests::patience; }

  const std::size_t at_once_ = PendingRequests::at_once_max();
  PendingRequests pending_;
  PendingRequests::Time now_{std::chrono::hours(1)};
  std::map<std::int64_t, std::shared_ptr<int>> completions_;  // of unanswered requests
  std::int64_t newest_ = 0;
  std::size_t forgotten_ = 0;
};

TEST_F(RequestsPending, AreReplacedAsTheyAreAnswered) {
  EXPECT_EQ(send(), at_once_);
  EXPECT_EQ(send(), 0u);
  answer(3);
  answer(newest_);
  EXPECT_EQ(send(), 2u);
  EXPECT_EQ(send(), 0u);
}

TEST_F(RequestsPending, GetNewRoomASecondAfterTheLastOne) {
  for (std::size_t second = 1; second <= 5; ++second) {
    EXPECT_EQ(send(), at_once_);
    now_ += PendingRequests::patience - std::chrono::milliseconds(1);
    EXPECT_EQ(send(), 0u);
    EXPECT_EQ(completions_.size(), second * at_once_);
    now_ += std::chrono::milliseconds(1);
  }
  EXPECT_EQ(send(), at_once_);
  answer(1);
  EXPECT_EQ(send(), 0u) << "the answer to an overdue request makes no room";
  completions_.clear();
  EXPECT_EQ(send(), at_once_);
  EXPECT_EQ(send(), 0u);
}

TEST_F(RequestsPending, BeyondTheLimitContinueAtThatPaceAndForgetTheOldest) {
  while (completions_.size() < PendingRequests::unanswered_max) {
    ASSERT_EQ(send(), at_once_);
    pass_time();
  }
  EXPECT_EQ(forgotten_, 0u);
  for (std::size_t second = 1; second <= 250; ++second) {
    ASSERT_EQ(send(), at_once_) << second;
    ASSERT_EQ(completions_.size(), PendingRequests::unanswered_max);
    ASSERT_EQ(forgotten_, second * at_once_);
    pass_time();
  }
}

TEST_F(RequestsPending, AreNotForgottenWhileOthersAreAnswered) {
  ASSERT_EQ(send(), at_once_);
  while (newest_ < static_cast<std::int64_t>(5 * PendingRequests::unanswered_max)) {
    answer(newest_);
    ASSERT_EQ(send(), 1u);
  }
  EXPECT_EQ(forgotten_, 0u);
  EXPECT_TRUE(completions_.contains(1));
}

}  // namespace
}  // namespace agnocast::bridge
