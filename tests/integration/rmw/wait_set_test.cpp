// SPDX-License-Identifier: Apache-2.0
//
// Goal: a wait ends for each trigger and each message, once, also where conditions are destroyed,
// shared and moved between wait sets meanwhile; an endless wait never ends for nothing.
// Method: threads of this process, with the real daemon; each step waits for what the other thread
// has seen.

#include <ros2/rmw_agnocast_cpp/core/wait_set.hpp>

#include <agnocast/agnocast.hpp>
#include <tests/integration/client/programs/second_process.hpp>
#include <tests/support/machine/syscall_tracer.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gmock/gmock.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <random>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::rmw {
namespace {

using namespace std::chrono_literals;
using test::eventually;
using test::Number;
using Clock = MessageWait::Clock;

class Messages final : public Readable {
 public:
  explicit Messages(PollingSubscriber<Number>::SharedPtr subscription)
      : subscription_(std::move(subscription)) {}
  bool is_ready() const noexcept override { return subscription_->has_unread(); }
  PollingSubscriber<Number>& operator*() const { return *subscription_; }

 private:
  PollingSubscriber<Number>::SharedPtr subscription_;
};

class WaitSets : public test::SuiteDaemon {
 protected:
  static void publish(Publisher<Number>& publisher, std::uint64_t value) {
    auto loan = publisher.borrow_loaned_message();
    loan->value = value;
    ASSERT_TRUE(publisher.publish(std::move(loan)));
  }
  Messages messages_of(const std::string& topic) {
    return Messages(node.create_subscription<Number>(topic, 10));
  }

  Node node{own("node")};
  WaitPool pool;
};

TEST_F(WaitSets, ATriggerBeforeTheWaitCountsOnce) {
  Condition condition, other;
  WaitSet set(pool);
  EXPECT_FALSE(set.wait({&condition}, {}, 0ns).value());
  condition.trigger();
  condition.trigger();
  EXPECT_TRUE(set.wait({&other, &condition, nullptr}, {}, std::nullopt).value());
  EXPECT_FALSE(set.is_condition_ready(0));
  EXPECT_TRUE(set.is_condition_ready(1));
  EXPECT_FALSE(set.is_condition_ready(2));
  EXPECT_FALSE(set.wait({&other, &condition}, {}, 0ns).value());
  EXPECT_FALSE(set.is_condition_ready(1));
}

TEST_F(WaitSets, ARepeatedConditionIsReportedAtEachPlace) {
  Condition condition;
  WaitSet set(pool);
  condition.trigger();
  EXPECT_TRUE(set.wait({&condition, nullptr, &condition}, {}, 1s).value());
  EXPECT_TRUE(set.is_condition_ready(0));
  EXPECT_TRUE(set.is_condition_ready(2));
  EXPECT_FALSE(set.wait({&condition}, {}, 0ns).value());
}

TEST_F(WaitSets, TimeoutsEndWithNothing) {
  Condition condition;
  WaitSet set(pool);
  const auto began = Clock::now();
  EXPECT_FALSE(set.wait({&condition}, {}, 30ms).value());
  EXPECT_GE(Clock::now() - began, 30ms);
  EXPECT_FALSE(set.wait({}, {}, 1ms).value());
  EXPECT_FALSE(set.wait({}, {}, -1ns).value());
}

// An executor makes and fills a wait set for each turn, and triggers conditions after each
// callback.
TEST_F(WaitSets, MakingThemAndTriggeringCostsNoSystemCallWhileNobodySleeps) {
#ifdef AGNOCAST_TEST_SANITIZED
  GTEST_SKIP() << "a sanitizer makes system calls of its own";
#endif
  const Messages messages = messages_of("/" + own("topic"));
  Condition once, always;
  const auto turn = [&] {
    always.trigger();
    once.trigger();
    always.trigger();
    WaitSet set(pool);
    return set.wait({&once, &always}, {&messages}, std::nullopt).value();
  };
  for (int i = 0; i < 10; ++i) ASSERT_TRUE(turn());
  test::allow_tracing();
  test::SyscallTracer tracer(::getpid());
  if (tracer.is_forbidden())
    GTEST_SKIP() << "tracing needs CAP_SYS_PTRACE here, or kernel.yama.ptrace_scope = 0";
  ASSERT_TRUE(tracer.is_tracing());
  test::mark_begin(0);
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  test::mark_end();
  test::mark_begin(1);
  for (int i = 0; i < 1000; ++i) (void)turn();
  test::mark_end();
  test::mark_begin(2);
  (void)WaitSet(pool).wait({}, {}, 1ms);
  test::mark_end();
  const auto clock = tracer.next(), turns = tracer.next(), sleep = tracer.next();
  ASSERT_TRUE(clock && turns && sleep);
  if (!clock->calls.empty())
    GTEST_SKIP() << "reading the clock is a system call here: no vDSO for its clock source";
  // A thread of the library may have a lock at that moment.
  EXPECT_LT(turns->calls.size(), 10u);
  EXPECT_FALSE(sleep->calls.empty()) << "the calls are not seen";
}

TEST_F(WaitSets, NoTriggerIsLostOrDoubled) {
  constexpr int count = 20'000;
  Condition asked, answered;
  std::thread answering([&] {
    for (int i = 0; i < count; ++i) {
      WaitSet set(pool);  // as rclpy makes them
      EXPECT_TRUE(set.wait({nullptr, &asked}, {}, std::nullopt).value());
      EXPECT_FALSE(set.wait({&asked}, {}, 0ns).value());
      answered.trigger();
    }
  });
  std::mt19937 random(3);
  WaitSet set(pool);
  for (int i = 0; i < count; ++i) {
    for (auto pause = random() % 32; pause > 0; --pause) std::this_thread::yield();
    asked.trigger();
    ASSERT_TRUE(set.wait({&answered}, {}, std::nullopt).value());
  }
  answering.join();
}

TEST_F(WaitSets, OfSeveralSetsOneGetsATrigger) {
  constexpr int count = 2'000, threads = 3;
  Condition shared, end;
  std::atomic<int> seen{0};
  std::atomic<bool> is_over{false};
  std::vector<std::thread> waiting;
  for (int i = 0; i < threads; ++i) {
    waiting.emplace_back([&] {
      WaitSet set(pool);
      while (!is_over) {
        ASSERT_TRUE(set.wait({&shared, &end}, {}, std::nullopt).value());
        if (set.is_condition_ready(0)) ++seen;
        if (set.is_condition_ready(1)) end.trigger();  // for the next one
      }
    });
  }
  for (int i = 1; i <= count; ++i) {
    shared.trigger();
    while (seen < i) std::this_thread::yield();
    ASSERT_EQ(seen, i);
  }
  is_over = true;
  end.trigger();
  for (std::thread& thread : waiting) thread.join();
  EXPECT_EQ(seen, count);
}

TEST_F(WaitSets, AConditionMayBeDestroyedWhileOthersWaitForIt) {
  for (int i = 0; i < 500; ++i) {
    auto doomed = std::make_unique<Condition>();
    Condition end;
    std::thread waiting([&, at = doomed.get()] {
      WaitSet set(pool);
      EXPECT_TRUE(set.wait({at, &end, at}, {}, std::nullopt).value());
      EXPECT_FALSE(set.is_condition_ready(0));
      EXPECT_TRUE(set.is_condition_ready(1));
    });
    // Not before wait() has the pointer: rclcpp keeps it until then.
    while (!doomed->is_waited_for()) std::this_thread::yield();
    if (i % 2 == 0) std::this_thread::sleep_for(100us);  // asleep, most likely
    doomed.reset();
    end.trigger();
    waiting.join();
  }
}

TEST_F(WaitSets, MessagesAreReadyUntilTheyAreTaken) {
  const Messages messages = messages_of(own("topic")), others = messages_of(own("other"));
  const auto publisher = node.create_publisher<Number>(own("topic"), 10);
  Condition condition;
  WaitSet set(pool);
  publish(*publisher, 1);
  for (int i = 0; i < 2; ++i) {
    ASSERT_TRUE(set.wait({&condition}, {&others, &messages}, std::nullopt).value());
    EXPECT_FALSE(set.is_condition_ready(0));
    EXPECT_FALSE(set.is_readable_ready(0));
    EXPECT_TRUE(set.is_readable_ready(1));
  }
  condition.trigger();
  ASSERT_TRUE(set.wait({&condition}, {&others, &messages}, std::nullopt).value());
  EXPECT_TRUE(set.is_condition_ready(0));
  EXPECT_TRUE(set.is_readable_ready(1));
  ASSERT_TRUE((*messages).take());
  EXPECT_FALSE(set.wait({&condition}, {&others, &messages, nullptr}, 0ns).value());
}

TEST_F(WaitSets, AnEndlessWaitDoesNotEndForWhatAnotherThreadTakes) {
  constexpr std::uint64_t count = 2'000;
  const Messages messages = messages_of(own("topic"));
  const auto publisher = node.create_publisher<Number>(own("topic"), 10);
  Condition end;
  std::atomic<std::uint64_t> taken{0};
  std::vector<std::thread> waiting;
  for (int i = 0; i < 3; ++i) {
    waiting.emplace_back([&] {
      WaitSet set(pool);
      for (;;) {
        ASSERT_TRUE(set.wait({&end}, {&messages}, std::nullopt).value());
        if (set.is_condition_ready(0)) return end.trigger();
        if ((*messages).take()) ++taken;
      }
    });
  }
  for (std::uint64_t value = 1; value <= count; ++value) {
    publish(*publisher, value);
    ASSERT_TRUE(eventually([&] { return taken == value; }));
  }
  end.trigger();
  for (std::thread& thread : waiting) thread.join();
}

#if !defined(AGNOCAST_TEST_THREADS_SANITIZED)
/// Seems to be due all the time.
class AlwaysDue final : public Readable {
 public:
  bool is_ready() const noexcept override {
    ++looks;
    return false;
  }
  Clock::time_point look_due() const noexcept override { return Clock::now() - 1s; }
  mutable std::atomic<int> looks{0};
};

TEST_F(WaitSets, WhatSeemsToBeDueIsNotLookedAtAllTheTime) {
  const AlwaysDue due;
  WaitSet set(pool);
  EXPECT_FALSE(set.wait({}, {&due}, 100ms).value());
  EXPECT_LT(due.looks, 1'000);  // three in each millisecond
}

/// Is ready in an hour.
class Late final : public Readable {
 public:
  bool is_ready() const noexcept override { return false; }
  Clock::time_point look_due() const noexcept override {
    return Clock::now() + std::chrono::hours(1);
  }
};

TEST_F(WaitSets, AForkedChildDoesNotWait) {
  Condition condition;
  const Late late;
  WaitSet set(pool);
  EXPECT_FALSE(set.wait({&condition}, {}, 1ns).value());  // it has slept
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) ::_exit(set.wait({&condition}, {&late}, std::nullopt).has_value() ? 1 : 0);
  int status = -1;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
}
#endif

}  // namespace
}  // namespace agnocast::rmw
