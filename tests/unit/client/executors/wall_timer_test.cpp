// SPDX-License-Identifier: Apache-2.0
//
// Wall timers: when their callbacks run, in which executor, and what cancel() and reset() change.
// No test asserts that a callback is early enough; a machine may be as slow as it likes.

#include <agnocast/executor.hpp>
#include <agnocast/timer.hpp>
#include <tests/support/memory/descriptors.hpp>
#include <tests/support/processes/actor.hpp>
#include <tests/unit/client/executors/node.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <memory>
#include <stdexcept>
#include <thread>
#include <vector>

namespace agnocast {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

template <class Condition>
void spin_until(Executor& executor, Condition condition) {
  while (!condition()) executor.spin_once();
}

TEST(WallTimer, RunsNothingBeforeAnExecutorSpins) {
  int calls = 0;
  const auto timer = create_wall_timer(node, 1ms, [&] { ++calls; });
  SingleThreadedExecutor executor;
  executor.add_node(node);
  std::this_thread::sleep_for(20ms);
  EXPECT_EQ(calls, 0);
  executor.spin_some();
  EXPECT_EQ(calls, 1) << "the periods that were over get no callbacks of their own";
}

TEST(WallTimer, IsDueAtMultiplesOfItsPeriodWhateverTheDelays) {
  constexpr auto period = 5ms;
  const auto before = Clock::now();
  SingleThreadedExecutor executor;
  executor.add_node(node);
  int calls = 0;
  const auto timer = create_wall_timer(node, period, [&] {
    if (++calls % 3 == 0) std::this_thread::sleep_for(7ms);  // misses one
  });
  const auto after = Clock::now();
  spin_until(executor, [&] { return calls == 20; });
  // From the creation to the next time is a multiple of the period. Both are known as intervals.
  const auto look_begin = Clock::now();
  const auto rest = timer->time_until_trigger();
  const auto look_end = Clock::now();
  const auto least = look_begin + rest - after, most = look_end + rest - before;
  EXPECT_GE(most - most % std::chrono::nanoseconds(period), least);
  EXPECT_GE(look_end - before, 20 * period) << "20 callbacks take 20 periods at least";
}

TEST(WallTimer, CancelsAndResets) {
  SingleThreadedExecutor executor;
  executor.add_node(node);
  int calls = 0;
  const auto timer = create_wall_timer(node, 1ms, [&](WallTimer& self) {
    if (++calls == 3) self.cancel();
  });
  EXPECT_EQ(timer->period(), 1ms);
  EXPECT_FALSE(timer->is_canceled());
  spin_until(executor, [&] { return timer->is_canceled(); });
  EXPECT_EQ(timer->time_until_trigger(), std::chrono::nanoseconds::max());
  executor.spin_once(20ms);
  EXPECT_EQ(calls, 3);
  timer->reset();
  EXPECT_LE(timer->time_until_trigger(), 1ms);
  EXPECT_FALSE(timer->is_canceled());
  spin_until(executor, [&] { return calls == 5; });
}

TEST(WallTimer, ResetWakesASleepingExecutor) {
  BackgroundExecutor executor;
  executor.add_node(node);
  std::atomic<int> calls{0};
  const auto timer = create_wall_timer(node, 1ms, [&](WallTimer& self) {
    self.cancel();
    ++calls;
  });
  // A sleep that nothing ends takes a second: 300 of them would be seen.
  const auto begin = Clock::now();
  for (int n = 1; n <= 300; ++n) {
    while (calls < n) std::this_thread::sleep_for(1ms);
    std::this_thread::sleep_for(2ms);
    timer->reset();
  }
  EXPECT_LT(Clock::now() - begin, 120s);
}

TEST(WallTimer, SharesOneDescriptorWithAllTimersOfTheExecutor) {
  SingleThreadedExecutor executor;
  executor.add_node(node);
  const std::size_t before = test::open_descriptor_count();
  std::vector<WallTimer::SharedPtr> timers;
  std::vector<int> calls(2000);
  for (std::size_t i = 0; i < calls.size(); ++i) {
    const auto group = create_callback_group(node, CallbackGroupType::MutuallyExclusive);
    timers.push_back(create_wall_timer(
        node, 1ms + i * 1us, [&calls, i] { ++calls[i]; }, group));
  }
  EXPECT_EQ(test::open_descriptor_count(), before);
  spin_until(executor, [&] { return testing::Value(calls, testing::Each(testing::Gt(1))); });
}

TEST(WallTimer, RunsOneCallbackAtATimeInAnExclusiveGroup) {
  MultiThreadedExecutor executor(4);
  executor.add_node(node);
  int unguarded = 0;
  std::atomic<int> inside{0};
  const auto count = [&] {
    EXPECT_EQ(++inside, 1);
    if (++unguarded == 3000) executor.cancel();
    --inside;
  };
  std::vector<WallTimer::SharedPtr> timers;
  for (int i = 0; i < 3; ++i) timers.push_back(create_wall_timer(node, 100us, count));
  executor.spin();
  EXPECT_GE(unguarded, 3000);
}

TEST(WallTimer, ServesThousandsOfGroupsInHundredsOfThreads) {
  MultiThreadedExecutor executor(200);
  executor.add_node(node);
  std::vector<std::atomic<int>> calls(2000);
  std::atomic<std::size_t> served{0};
  std::vector<WallTimer::SharedPtr> timers;
  for (auto& count : calls) {
    timers.push_back(create_wall_timer(
        node, 10ms,
        [&] {
          if (++count == 2 && ++served == calls.size()) executor.cancel();
        },
        create_callback_group(node, CallbackGroupType::MutuallyExclusive)));
  }
  executor.spin();
  EXPECT_EQ(served, calls.size());
}

TEST(WallTimer, RunsBesideItselfInAReentrantGroup) {
  MultiThreadedExecutor executor(2);
  const auto group = create_callback_group(node, CallbackGroupType::Reentrant);
  executor.add_node(node);
  std::atomic<int> inside{0};
  const auto timer = create_wall_timer(
      node, 1ms,
      [&] {
        ++inside;
        while (inside < 2) std::this_thread::yield();  // until another thread is here as well
        executor.cancel();
      },
      group);
  executor.spin();
  EXPECT_EQ(inside, 2);
}

TEST(WallTimer, MayEndInItsOwnCallback) {
  SingleThreadedExecutor executor;
  executor.add_node(node);
  int calls = 0;
  WallTimer::SharedPtr timer = create_wall_timer(node, 1ms, [&](WallTimer& self) {
    timer.reset();
    self.reset();  // still an object
    ++calls;
  });
  spin_until(executor, [&] { return calls == 1; });
  executor.spin_once(10ms);
  EXPECT_EQ(calls, 1);
}

TEST(WallTimer, LetsExceptionsLeaveTheSpinAndGoesOn) {
  SingleThreadedExecutor executor;
  executor.add_node(node);
  int calls = 0;
  const auto timer = create_wall_timer(node, 1ms, [&] {
    if (++calls == 1) throw std::runtime_error("from a timer");
  });
  EXPECT_THROW(executor.spin(), std::runtime_error);
  spin_until(executor, [&] { return calls == 2; });
}

TEST(WallTimer, OfAnyPeriodLeavesTheOthersTheirTurn) {
  SingleThreadedExecutor executor;
  executor.add_node(node);
  int always = 0, sometimes = 0;
  const auto first = create_wall_timer(node, 0ns, [&] { ++always; });
  const auto second = create_wall_timer(node, 2ms, [&] { ++sometimes; });
  const auto never = create_wall_timer(node, std::chrono::hours(24 * 365 * 200), [] { FAIL(); });
  spin_until(executor, [&] { return sometimes == 3; });
  EXPECT_GT(always, 3);
}

TEST(WallTimer, RefusesWhatIsNoPeriodAndGroupsOfOthers) {
  const auto refusal = [](auto period) {
    const auto made = try_create_wall_timer(node, period, [] {});
    return made ? Errc::ok : made.error().code;
  };
  EXPECT_EQ(refusal(-1ns), Errc::invalid_argument);
  EXPECT_EQ(refusal(std::chrono::hours::max()), Errc::invalid_argument);
  EXPECT_EQ(refusal(std::chrono::duration<double>(std::nan(""))), Errc::invalid_argument);
  const auto other =
      create_callback_group(test::ActorNode("other"), CallbackGroupType::MutuallyExclusive);
  EXPECT_THROW(create_wall_timer(
                   node, 1s, [] {}, other),
               Error);
}

}  // namespace
}  // namespace agnocast
