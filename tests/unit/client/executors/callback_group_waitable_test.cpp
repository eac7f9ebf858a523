// SPDX-License-Identifier: Apache-2.0
//
// A callback group in an event loop of others. Its callbacks are those of timers, which need no
// daemon; messages come the same way.

#include <agnocast/callback_group_waitable.hpp>
#include <agnocast/executor.hpp>
#include <agnocast/timer.hpp>
#include <tests/unit/client/executors/node.hpp>

#include <gtest/gtest.h>

#include <poll.h>

#include <atomic>
#include <chrono>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>

namespace agnocast {
namespace {

using namespace std::chrono_literals;

CallbackGroup::SharedPtr make_group(CallbackGroupType type) {
  return create_callback_group(node, type, false);
}
bool is_readable(const CallbackGroupWaitable& waitable, int timeout_ms) {
  pollfd entry{waitable.fd(), POLLIN, 0};
  return ::poll(&entry, 1, timeout_ms) == 1;
}
/// Waits as the header says, then runs a callback.
void run_next(CallbackGroupWaitable& waitable) {
  do {
    while (!waitable.prepare()) ASSERT_TRUE(is_readable(waitable, -1));
  } while (!waitable.run_one());  // another thread was faster
}

TEST(CallbackGroupWaitable, IsReadableWhenACallbackCanBegin) {
  const auto group = make_group(CallbackGroupType::MutuallyExclusive);
  CallbackGroupWaitable waitable(*group);
  EXPECT_FALSE(waitable.prepare());
  EXPECT_FALSE(waitable.run_one());
  int calls = 0;
  const auto timer = create_wall_timer(
      node, 2ms, [&] { ++calls; }, group);
  for (int i = 0; i < 10; ++i) run_next(waitable);
  EXPECT_EQ(calls, 10);
  EXPECT_EQ(waitable.fd(), waitable.fd());
}

TEST(CallbackGroupWaitable, IsReadableAtOnceAfterAReset) {
  const auto group = make_group(CallbackGroupType::MutuallyExclusive);
  CallbackGroupWaitable waitable(*group);
  int calls = 0;
  const auto timer = create_wall_timer(
      node, 1ms,
      [&](WallTimer& self) {
        ++calls;
        self.cancel();
      },
      group);
  run_next(waitable);
  const auto begin = std::chrono::steady_clock::now();
  constexpr int resets = 300;
  for (int i = 0; i < resets; ++i) {
    EXPECT_FALSE(waitable.prepare());
    std::thread([&] { timer->reset(); }).join();
    run_next(waitable);
  }
  EXPECT_EQ(calls, 1 + resets);
  // The tick of the sleep comes once a second.
  EXPECT_LT(std::chrono::steady_clock::now() - begin, 120s);
}

TEST(CallbackGroupWaitable, HasNothingWhileAnExclusiveGroupIsBusy) {
  const auto group = make_group(CallbackGroupType::MutuallyExclusive);
  CallbackGroupWaitable waitable(*group);
  const auto other = create_wall_timer(
      node, 0ns, [] {}, group);
  const auto timer = create_wall_timer(
      node, 0ns,
      [&] {
        std::thread([&] {
          EXPECT_EQ(waitable.ready_count(), 0u);
          EXPECT_FALSE(waitable.prepare());
          EXPECT_FALSE(waitable.run_one());
        }).join();
      },
      group);
  for (int i = 0; i < 4; ++i) run_next(waitable);
  EXPECT_EQ(waitable.ready_count(), 2u) << "one of each timer";
}

TEST(CallbackGroupWaitable, RunsTheCallbackThatRanLongestAgo) {
  const auto group = make_group(CallbackGroupType::MutuallyExclusive);
  CallbackGroupWaitable waitable(*group);
  std::string order;
  const auto make_timer = [&](char name) {
    auto timer = create_wall_timer(
        node, 0ns, [&order, name] { order += name; }, group);
    timer->cancel();
    return timer;
  };
  const auto first = make_timer('a'), second = make_timer('b'), third = make_timer('c');
  second->reset();
  for (int i = 0; i < 2; ++i) run_next(waitable);
  EXPECT_EQ(order, "bb");
  first->reset();
  third->reset();
  // Each of the three before any again, although the loop of this test knows no cycles.
  for (int i = 0; i < 6; ++i) run_next(waitable);
  EXPECT_EQ(order, "bbacbacb");
}

TEST(CallbackGroupWaitable, RunsAReentrantGroupInManyThreads) {
  const auto group = make_group(CallbackGroupType::Reentrant);
  CallbackGroupWaitable waitable(*group);
  std::atomic<int> inside{0};
  const auto timer = create_wall_timer(
      node, 1ms,
      [&] {
        ++inside;
        while (inside < 2) std::this_thread::yield();  // until another thread is here as well
      },
      group);
  std::thread other([&] { run_next(waitable); });
  run_next(waitable);
  other.join();
  EXPECT_EQ(inside, 2);
}

TEST(CallbackGroupWaitable, IsTheOnlyExecutorOfItsGroup) {
  const auto group = make_group(CallbackGroupType::MutuallyExclusive);
  SingleThreadedExecutor executor;
  std::optional<CallbackGroupWaitable> waitable(std::in_place, *group);
  EXPECT_THROW(executor.add_callback_group(group), Error);
  EXPECT_THROW(CallbackGroupWaitable{*group}, Error);
  waitable.reset();
  executor.add_callback_group(group);
  EXPECT_THROW(CallbackGroupWaitable{*group}, Error);
}

TEST(CallbackGroupWaitable, PassesExceptionsOn) {
  const auto group = make_group(CallbackGroupType::MutuallyExclusive);
  CallbackGroupWaitable waitable(*group);
  const auto timer = create_wall_timer(
      node, 0ns, [] { throw std::runtime_error("out"); }, group);
  EXPECT_THROW((void)waitable.run_one(), std::runtime_error);
  EXPECT_EQ(waitable.ready_count(), 1u);
}

TEST(CallbackGroupWaitable, MayEndBeforeOrAfterItsGroup) {
  auto group = make_group(CallbackGroupType::MutuallyExclusive);
  CallbackGroupWaitable waitable(*group);
  group.reset();
  EXPECT_FALSE(waitable.prepare());
  EXPECT_FALSE(waitable.run_one());
}

}  // namespace
}  // namespace agnocast
