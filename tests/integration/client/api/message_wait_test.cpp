// SPDX-License-Identifier: Apache-2.0
//
// Goal: a thread that waits for messages wakes for each of them, for each wake(), and at its end; a
// look that comes too early costs nothing but another look.
// Method: threads of this process, with the real daemon; each step waits for what the other thread
// has seen. (A wake-up that is lost is made good by the tick of a second, and only delays the
// test.)

#include <agnocast/agnocast.hpp>
#include <tests/integration/client/programs/second_process.hpp>
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
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using test::eventually;
using test::Number;
using Clock = MessageWait::Clock;

class MessageWaits : public test::SuiteDaemon {
 protected:
  static void publish(Publisher<Number>& publisher, std::uint64_t value) {
    auto loan = publisher.borrow_loaned_message();
    loan->value = value;
    ASSERT_TRUE(publisher.publish(std::move(loan)));
  }
  static bool never() noexcept { return false; }

  Node node{own("node")};
};

TEST_F(MessageWaits, EndWithEachMessage) {
  constexpr std::uint64_t count = 500;
  const auto publisher = node.create_publisher<Number>(own("topic"), 1);
  const auto subscription = node.create_subscription<Number>(own("topic"), 1);
  std::atomic<std::uint64_t> seen{0};
  std::thread reader([&] {
    MessageWait wait;
    while (seen < count) {
      EXPECT_TRUE(wait.wait([&] { return subscription->has_unread(); }));
      while (const auto message = subscription->take()) seen = message->value;
    }
  });
  std::mt19937 random(7);
  for (std::uint64_t value = 1; value <= count; ++value) {
    std::this_thread::sleep_for(std::chrono::microseconds(random() % 200));
    publish(*publisher, value);
    ASSERT_TRUE(eventually([&] { return seen == value; }));
  }
  reader.join();
}

TEST_F(MessageWaits, EndWithTheFirstMessageOfALatePublisher) {
  const auto subscription = node.create_subscription<Number>(own("topic"), 1);
  std::atomic<bool> is_taken{false};
  std::thread publishing([&] {
    const auto publisher = node.create_publisher<Number>(own("topic"), 1);
    publish(*publisher, 3);
    ASSERT_TRUE(eventually([&] { return is_taken.load(); }));
  });
  MessageWait wait;
  EXPECT_TRUE(wait.wait([&] { return subscription->has_unread(); }));
  const auto message = subscription->take();
  is_taken = true;
  publishing.join();
  ASSERT_TRUE(message);
  EXPECT_EQ(message->value, 3u);
}

TEST_F(MessageWaits, OfSeveralThreadsAllEnd) {
  constexpr int threads = 4;
  const auto publisher = node.create_publisher<Number>(own("topic"), 1);
  std::vector<PollingSubscriber<Number>::SharedPtr> subscriptions;
  for (int i = 0; i < threads; ++i)
    subscriptions.push_back(node.create_subscription<Number>(own("topic"), 1));
  std::atomic<int> seen{0};
  std::vector<std::thread> readers;
  for (const auto& subscription : subscriptions) {
    readers.emplace_back([&] {
      MessageWait wait;
      for (std::uint64_t value = 1; value <= 20; ++value) {
        std::uint64_t taken = 0;
        while (taken != value) {
          EXPECT_TRUE(wait.wait([&] { return subscription->has_unread(); }));
          while (const auto message = subscription->take()) taken = message->value;
        }
        ++seen;
      }
    });
  }
  for (std::uint64_t value = 1; value <= 20; ++value) {
    publish(*publisher, value);
    ASSERT_TRUE(eventually([&] { return seen == threads * static_cast<int>(value); }));
  }
  for (std::thread& reader : readers) reader.join();
}

TEST_F(MessageWaits, EndWithEachWake) {
  constexpr int count = 20'000;
  MessageWait wait;
  std::atomic<int> asked{0}, answered{0};
  std::thread answering([&] {
    for (int i = 1; i <= count; ++i) {
      EXPECT_TRUE(wait.wait([&] { return asked == i; }));
      answered = i;
    }
  });
  std::mt19937 random(11);
  for (int i = 1; i <= count; ++i) {
    for (auto pause = random() % 64; pause > 0; --pause) std::this_thread::yield();
    asked = i;
    wait.wake();
    while (answered != i) std::this_thread::yield();
  }
  answering.join();
}

TEST_F(MessageWaits, EndAtTheirTime) {
  MessageWait wait;
  const auto end = Clock::now() + std::chrono::milliseconds(30);
  EXPECT_FALSE(wait.wait_until(end, never));
  EXPECT_GE(Clock::now(), end);
  EXPECT_FALSE(wait.wait_until(Clock::time_point::min(), never)) << "a look only";
  EXPECT_TRUE(wait.wait_until(Clock::time_point::min(), [] { return true; }));
}

TEST_F(MessageWaits, DoNotSleepInAForkedChild) {
  MessageWait wait;
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) ::_exit(wait.wait(never) ? 1 : 0);
  int status = -1;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
}

}  // namespace
}  // namespace agnocast
