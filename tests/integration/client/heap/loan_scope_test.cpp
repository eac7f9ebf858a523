// SPDX-License-Identifier: Apache-2.0
//
// Goal: a loan's memory is shared in every thread that fills it, and no other memory is. Method:
// publisher and subscription in this process, the real daemon and hook; the hook says where an
// address lies, and publish how much it had to adopt.

#include <agnocast/abi/heaphook.h>
#include <agnocast/agnocast.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <sensor_msgs/msg/point_cloud2.hpp>

#include <gmock/gmock.h>

#include <atomic>
#include <cstdlib>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using Cloud = sensor_msgs::msg::PointCloud2;
using test::take_soon;

/// Returns whether a fresh allocation of this thread is shared.
bool allocates_shared() {
  const auto block = std::make_unique<std::vector<int>>(1000);
  return agnocast_heaphook()->owns(block->data()) != 0;
}

class LoanScopes : public test::SuiteDaemon {
 protected:
  void SetUp() override {
    subscription = create_subscription<Cloud>(test::PlainNode(), "points", QoS(5));
    publisher = create_publisher<Cloud>(test::PlainNode(), "points", 5);
    ASSERT_FALSE(allocates_shared()) << "no loan is open";
  }
  void TearDown() override {
    EXPECT_FALSE(allocates_shared()) << "a scope was left open";
    agnocast_heaphook_usage usage{};
    agnocast_heaphook()->usage(&usage);
    EXPECT_EQ(usage.internal_error_count, 0u);
  }
  Publisher<Cloud>::SharedPtr publisher;
  Subscription<Cloud>::SharedPtr subscription;
};

void fill_field(Cloud& cloud, std::size_t i) {
  cloud.fields[i].name.assign(1000, static_cast<char>('a' + i));
}

TEST_F(LoanScopes, WorkersFillALoanAndNothingIsAdopted) {
  auto loan = publisher->borrow_loaned_message();
  loan->fields.resize(8);
  std::vector<std::thread> workers;
  for (std::size_t i = 0; i < loan->fields.size(); ++i) {
    workers.emplace_back([&loan, i] {
      EXPECT_FALSE(allocates_shared()) << "a loan opens the scope of its own thread only";
      {
        const LoanScope scope(loan);
        EXPECT_TRUE(scope.is_open());
        fill_field(*loan, i);
      }
      EXPECT_FALSE(allocates_shared());
    });
  }
  for (std::thread& worker : workers) worker.join();
  const PublishResult result = publisher->publish(std::move(loan));
  ASSERT_TRUE(result);
  EXPECT_EQ(result.adopted_bytes, 0u);
  const auto received = take_soon(subscription);
  ASSERT_TRUE(received);
  for (std::size_t i = 0; i < 8; ++i)
    EXPECT_EQ(received->fields[i].name, std::string(1000, static_cast<char>('a' + i)));
}

TEST_F(LoanScopes, MemoryOfAWorkerWithoutAScopeIsAdopted) {
  auto loan = publisher->borrow_loaned_message();
  loan->fields.resize(1);
  std::thread([&] { fill_field(*loan, 0); }).join();
  EXPECT_EQ(publisher->publish(std::move(loan)).adopted_bytes, 1001u);
}

TEST_F(LoanScopes, APauseMakesWorkingMemoryPrivateUntilItEnds) {
  auto loan = publisher->borrow_loaned_message();
  EXPECT_TRUE(allocates_shared());
  {
    const LoanPause pause;
    EXPECT_FALSE(allocates_shared());
    {
      const LoanPause inner;
      EXPECT_FALSE(allocates_shared());
    }
    const LoanScope scope(loan);
    EXPECT_FALSE(allocates_shared()) << "a pause overrides scopes";
  }
  EXPECT_TRUE(allocates_shared());
  loan->data.assign(1000, 3);
  EXPECT_EQ(publisher->publish(std::move(loan)).adopted_bytes, 0u);
}

TEST_F(LoanScopes, PublishWorksDuringAPause) {
  auto loan = publisher->borrow_loaned_message();
  const LoanPause pause;
  loan->data.assign(1000, 3);
  const PublishResult moved = publisher->publish(std::move(loan));
  ASSERT_TRUE(moved) << sentence_of(moved.code);
  EXPECT_EQ(moved.adopted_bytes, 1000u);
  EXPECT_FALSE(allocates_shared()) << "the pause goes on";
  const auto received = take_soon(subscription);
  ASSERT_TRUE(received);
  EXPECT_TRUE(agnocast_heaphook()->owns(received->data.data()));
}

TEST_F(LoanScopes, ALoanSetAsideLeavesItsThreadAndIsFilledLaterInAScope) {
  auto loan = publisher->borrow_loaned_message();
  auto copy = loan;
  EXPECT_TRUE(publisher->pause(loan));
  EXPECT_FALSE(allocates_shared());
  EXPECT_TRUE(publisher->pause(loan)) << "a second pause has no effect";
  {
    const LoanScope scope(copy);
    loan->data.assign(1000, 3);
  }
  EXPECT_FALSE(allocates_shared());
  EXPECT_EQ(publisher->publish(std::move(loan)).adopted_bytes, 0u);
  EXPECT_FALSE(publisher->pause(copy)) << "it is already published";
}

TEST_F(LoanScopes, ALoanPausedInAnotherThreadIsLeftAtTheNextBorrow) {
  auto loan = publisher->borrow_loaned_message();
  std::thread([&] { EXPECT_TRUE(publisher->pause(loan)); }).join();
  publisher->borrow_loaned_message().reset();
  EXPECT_FALSE(allocates_shared());
  EXPECT_TRUE(publisher->publish(std::move(loan)));
}

TEST_F(LoanScopes, OnlyALoanOpensAScope) {
  auto other = create_publisher<Cloud>(test::PlainNode(), "other", 5);
  auto loan = publisher->borrow_loaned_message();
  EXPECT_FALSE(other->pause(loan)) << "the loan of another publisher";
  auto copy = loan;
  ASSERT_TRUE(publisher->publish(std::move(loan)));
  EXPECT_FALSE(LoanScope(copy).is_open()) << "it is already published";
  EXPECT_FALSE(LoanScope(ipc_shared_ptr<Cloud>()).is_open());
  const auto received = take_soon(subscription);
  ASSERT_TRUE(received);
  EXPECT_FALSE(LoanScope(received).is_open());
  EXPECT_FALSE(publisher->pause({}));
}

TEST_F(LoanScopes, OneOfManyThreadsPublishesALoanAndTheOthersGetAnError) {
  for (int round = 0; round < 200; ++round) {
    auto loan = publisher->borrow_loaned_message();
    EXPECT_TRUE(publisher->pause(loan)) << "the loan is handed over";
    std::atomic<int> published{0}, refused{0};
    std::vector<std::thread> threads;
    for (int i = 0; i < 3; ++i) {
      threads.emplace_back([&, copy = loan]() mutable {
        (void)copy.get();
        const PublishResult result = publisher->publish(std::move(copy));
        if (result) ++published;
        if (result.code == Errc::loan_invalid) ++refused;
      });
    }
    for (std::thread& thread : threads) thread.join();
    ASSERT_EQ(published, 1);
    ASSERT_EQ(refused, 2);
    EXPECT_FALSE(loan);
    loan.reset();
  }
}

TEST_F(LoanScopes, AMessageMadeInASharedScopeIsPublishedWithoutACopyByAnyPublisher) {
  std::unique_ptr<Cloud> made;
  std::thread maker([&] {
    const SharedHeapScope scope;
    EXPECT_TRUE(scope.is_open());
    made = std::make_unique<Cloud>();
    made->data.assign(100'000, 7);
    const SharedHeapScope nested;
  });
  maker.join();
  ASSERT_FALSE(allocates_shared());
  auto other = create_publisher<Cloud>(test::PlainNode(), "points", 5);
  const PublishResult result = other->publish(std::move(made));
  EXPECT_TRUE(result);
  EXPECT_EQ(result.adopted_bytes, 0u);
  const auto taken = take_soon(subscription);
  ASSERT_TRUE(taken);
  EXPECT_EQ(taken->data.size(), 100'000u);
}

}  // namespace
}  // namespace agnocast
