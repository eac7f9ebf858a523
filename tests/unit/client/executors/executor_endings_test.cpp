// SPDX-License-Identifier: Apache-2.0
//
// Executors whose threads, callbacks or nodes end at a bad moment. What ends a process is in
// executor_program_test.cpp.

#include <agnocast/executor.hpp>
#include <agnocast/timer.hpp>
#include <tests/unit/client/executors/node.hpp>

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using namespace std::chrono_literals;

template <class E>
class SpinningExecutors : public testing::Test {};
using Kinds =
    testing::Types<SingleThreadedExecutor, MultiThreadedExecutor, CallbackIsolatedExecutor>;
TYPED_TEST_SUITE(SpinningExecutors, Kinds);

TYPED_TEST(SpinningExecutors, AnExceptionLeavesTheCancelToTheNextSpin) {
  TypeParam executor;
  executor.add_node(node);
  const auto timer = create_wall_timer(node, 1ms, [&] {
    executor.cancel();
    throw std::runtime_error("while cancelled");
  });
  EXPECT_THROW(executor.spin(), std::runtime_error);
  timer->cancel();
  executor.spin();  // returns at once
  EXPECT_FALSE(executor.is_spinning());
}

TYPED_TEST(SpinningExecutors, GroupsComeAndGoWhileItSpins) {
  TypeParam executor;
  std::thread spinning([&] { executor.spin(); });
  std::atomic<int> calls{0};
  for (int round = 0; round < 50; ++round) {
    const auto group = create_callback_group(node, CallbackGroupType::MutuallyExclusive, false);
    const auto timer = create_wall_timer(
        node, 0ns, [&] { ++calls; }, group);
    executor.add_callback_group(group);
    const int before = calls;
    while (calls == before) std::this_thread::yield();
    if (round % 2 != 0) executor.remove_callback_group(group);
  }
  executor.cancel();
  spinning.join();
}

template <class E>
class ExecutorsWithThreads : public testing::Test {};
using KindsWithThreads = testing::Types<MultiThreadedExecutor, CallbackIsolatedExecutor>;
TYPED_TEST_SUITE(ExecutorsWithThreads, KindsWithThreads);

TYPED_TEST(ExecutorsWithThreads, ACallbackThatStillRunsDelaysNoOtherGroup) {
  TypeParam executor;
  std::atomic<bool> is_inside{false}, may_end{false};
  std::thread spinning([&] { executor.spin(); });
  auto group = create_callback_group(node, CallbackGroupType::MutuallyExclusive, false);
  auto blocking = create_wall_timer(
      node, 0ns,
      [&] {
        is_inside = true;
        while (!may_end) std::this_thread::yield();
      },
      group);
  executor.add_callback_group(group);
  while (!is_inside) std::this_thread::yield();
  executor.remove_callback_group(group);  // its callback still runs
  for (int i = 0; i < 3; ++i) {
    std::atomic<int> calls{0};
    const auto next = create_callback_group(node, CallbackGroupType::MutuallyExclusive, false);
    const auto timer = create_wall_timer(
        node, 0ns, [&] { ++calls; }, next);
    executor.add_callback_group(next);
    while (calls == 0) std::this_thread::yield();
  }
  may_end = true;
  blocking.reset();
  executor.cancel();
  spinning.join();
}

// One of two threads that run callbacks of `ending` waits for the thread that destroys it, so that
// thread cannot wait for it; but for the other one it can.
TEST(ReentrantGroup, ADestructorWaitsForAllThreadsThatItCan) {
  MultiThreadedExecutor executor(4);
  executor.add_node(node);
  const auto group = create_callback_group(node, CallbackGroupType::Reentrant);
  std::atomic<int> inside{0};
  std::atomic<bool> first_waits{false}, second_is_over{false}, destroyed_early{false}, over{false};
  WallTimer::SharedPtr ending, destroying;
  const auto second_phase = [&] {
    while (inside < 2 || !first_waits) std::this_thread::yield();
    std::this_thread::sleep_for(100ms);
    second_is_over = true;
  };
  ending = create_wall_timer(
      node, 1ms,
      [&] {
        const int place = ++inside;
        if (place == 2) second_phase();
        if (place != 1) return;
        while (inside < 2) std::this_thread::yield();
        first_waits = true;
        destroying.reset();  // waits for its callback, below
      },
      group);
  destroying = create_wall_timer(
      node, 1ms,
      [&, once = false]() mutable {
        if (std::exchange(once, true)) return;
        while (!first_waits) std::this_thread::yield();
        std::this_thread::sleep_for(20ms);
        ending.reset();
        destroyed_early = !second_is_over;
        over = true;
        executor.cancel();
      },
      create_callback_group(node, CallbackGroupType::MutuallyExclusive));
  executor.spin();
  EXPECT_TRUE(over);
  EXPECT_FALSE(destroyed_early);
}

}  // namespace
}  // namespace agnocast
