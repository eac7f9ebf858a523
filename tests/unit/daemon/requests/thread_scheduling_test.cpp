// SPDX-License-Identifier: Apache-2.0
//
// Goal: what set_scheduling() reports is what the kernel says of the thread; a number that is no
// thread of the process changes nothing.
// Method: threads of this process and of a child. Real-time policies are tested where this process
// may set them.

#include <daemon/requests/thread_scheduling.hpp>

#include <gtest/gtest.h>

#include <sched.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <future>
#include <thread>

namespace agnocast::daemon {
namespace {

using abi::wire::ThreadCall;
using abi::wire::ThreadScheduling;
using abi::wire::ThreadSetting;

pid_t thread_id() { return static_cast<pid_t>(::syscall(SYS_gettid)); }

/// A thread that waits until the end of the scope.
class WaitingThread {
 public:
  WaitingThread() {
    std::promise<pid_t> number;
    thread_ = std::thread([this, &number] {
      number.set_value(thread_id());
      end_.get_future().wait();
    });
    number_ = number.get_future().get();
  }
  ~WaitingThread() { join(); }
  void join() {
    if (!thread_.joinable()) return;
    end_.set_value();
    thread_.join();
  }
  std::uint32_t number() const { return static_cast<std::uint32_t>(number_); }
  int policy() const { return ::sched_getscheduler(number_); }
  int nice() const { return ::getpriority(PRIO_PROCESS, static_cast<id_t>(number_)); }

 private:
  std::promise<void> end_;
  std::thread thread_;
  pid_t number_ = 0;
};

ThreadScheduling policy(std::uint32_t wanted, std::uint32_t priority = 0) {
  ThreadScheduling scheduling{};
  scheduling.sets_policy = 1;
  scheduling.policy = wanted;
  scheduling.priority = priority;
  return scheduling;
}

class SetScheduling : public testing::Test {
 protected:
  static bool may_be_real_time() {
    const sched_param wanted{1};
    const sched_param ordinary{0};
    const bool may = ::sched_setscheduler(0, SCHED_FIFO, &wanted) == 0;
    ::sched_setscheduler(0, SCHED_OTHER, &ordinary);
    return may;
  }
  /// Returns why a thread that may use all processors gets no deadline here; 0: it gets one.
  static int refusal_of_a_deadline() {
    struct {
      std::uint32_t size, policy;
      std::uint64_t flags;
      std::int32_t nice;
      std::uint32_t priority;
      std::uint64_t runtime, deadline, period;
    } wanted{sizeof wanted, SCHED_DEADLINE, 0, 0, 0, 1'000'000, 10'000'000, 10'000'000};
    int error = 0;
    std::thread([&] {
      cpu_set_t all;
      std::memset(&all, 0xff, sizeof all);
      ::sched_setaffinity(0, sizeof all, &all);  // as a deadline needs
      if (::syscall(SYS_sched_setattr, 0, &wanted, 0) != 0) error = errno;
    }).join();
    return error;
  }
  CallbackThreads::Outcome set(const WaitingThread& thread, const ThreadScheduling& wanted) {
    return set_scheduling(mine(), thread.number(), wanted);
  }

  ThreadOwner mine() const { return {self, ::getpid(), ::geteuid()}; }

  Pidfd self = *Pidfd::open(::getpid());
};

TEST_F(SetScheduling, SetsAPolicyAndANiceValue) {
  WaitingThread thread;
  EXPECT_EQ(set(thread, policy(SCHED_BATCH)).setting, ThreadSetting::applied);
  EXPECT_EQ(thread.policy(), SCHED_BATCH) << "without SCHED_RESET_ON_FORK, which binds the process";
  ThreadScheduling nice{};
  nice.sets_nice = 1;
  nice.nice = 7;
  EXPECT_EQ(set(thread, nice).setting, ThreadSetting::applied);
  EXPECT_EQ(thread.nice(), 7);
  EXPECT_EQ(thread.policy(), SCHED_BATCH) << "what it does not set stays";
}

TEST_F(SetScheduling, SetsProcessors) {
  cpu_set_t mine;
  ASSERT_EQ(::sched_getaffinity(0, sizeof mine, &mine), 0);
  std::size_t last = 0;
  for (std::size_t cpu = 0; cpu < CPU_SETSIZE; ++cpu) {
    if (CPU_ISSET(cpu, &mine)) last = cpu;
  }
  WaitingThread thread;
  ThreadScheduling wanted{};
  wanted.sets_cpus = 1;
  wanted.cpus[last / 64] = std::uint64_t{1} << last % 64;
  EXPECT_EQ(set(thread, wanted).setting, ThreadSetting::applied);
  cpu_set_t its;
  ASSERT_EQ(::sched_getaffinity(static_cast<pid_t>(thread.number()), sizeof its, &its), 0);
  EXPECT_EQ(CPU_COUNT(&its), 1);
  EXPECT_TRUE(CPU_ISSET(last, &its));
}

TEST_F(SetScheduling, SaysWhichCallTheKernelRefused) {
  WaitingThread thread;
  ThreadScheduling wanted{};
  wanted.sets_cpus = 1;
  wanted.cpus[15] = std::uint64_t{1} << 63;  // no machine of a test has processor 1023
  const CallbackThreads::Outcome outcome = set(thread, wanted);
  EXPECT_EQ(outcome.setting, ThreadSetting::refused);
  EXPECT_EQ(outcome.call, ThreadCall::sched_setaffinity);
  EXPECT_EQ(outcome.os_errno, EINVAL);
  const CallbackThreads::Outcome other = set(thread, policy(77));
  EXPECT_EQ(other.setting, ThreadSetting::refused);
  EXPECT_EQ(other.call, ThreadCall::sched_setattr);
  EXPECT_EQ(other.os_errno, EINVAL);
}

/// Returns the policy of a thread that this thread starts.
int policy_of_child() {
  int policy = -1;
  std::thread([&policy] { policy = ::sched_getscheduler(0); }).join();
  return policy;
}

TEST_F(SetScheduling, SetsRealTimePoliciesThatTheThreadsOfTheThreadDoNotInherit) {
  if (!may_be_real_time()) GTEST_SKIP() << "this process may not set real-time policies";
  std::thread([this] {
    const auto number = static_cast<std::uint32_t>(thread_id());
    ThreadScheduling nice{};
    nice.sets_nice = 1;
    nice.nice = 9;
    ASSERT_EQ(set_scheduling(mine(), number, nice).setting, ThreadSetting::applied);
    EXPECT_EQ(set_scheduling(mine(), number, policy(SCHED_FIFO, 3)).setting,
              ThreadSetting::applied);
    EXPECT_EQ(::sched_getscheduler(0), SCHED_FIFO | SCHED_RESET_ON_FORK);
    sched_param parameters{};
    ASSERT_EQ(::sched_getparam(0, &parameters), 0);
    EXPECT_EQ(parameters.sched_priority, 3);
    EXPECT_EQ(policy_of_child(), SCHED_OTHER);
    EXPECT_EQ(set_scheduling(mine(), number, policy(SCHED_OTHER)).setting, ThreadSetting::applied);
    EXPECT_EQ(::getpriority(PRIO_PROCESS, 0), 9) << "what it does not set stays";
  }).join();
}

TEST_F(SetScheduling, SetsADeadlineAlsoForAThreadThatWasBoundToAProcessor) {
  if (const int error = refusal_of_a_deadline(); error == EPERM || error == EBUSY)
    GTEST_SKIP() << "SCHED_DEADLINE needs CAP_SYS_NICE, and room: " << std::strerror(error);
  WaitingThread thread;
  ThreadScheduling bound{};
  bound.sets_cpus = 1;
  cpu_set_t mine;
  ASSERT_EQ(::sched_getaffinity(0, sizeof mine, &mine), 0);
  std::size_t first = 0;
  while (!CPU_ISSET(first, &mine)) ++first;
  bound.cpus[first / 64] = std::uint64_t{1} << first % 64;
  ASSERT_EQ(set(thread, bound).setting, ThreadSetting::applied);
  ThreadScheduling wanted = policy(SCHED_DEADLINE);
  wanted.runtime_ns = 1'000'000;
  wanted.deadline_ns = 10'000'000;
  wanted.period_ns = 10'000'000;
  EXPECT_EQ(set(thread, wanted).setting, ThreadSetting::applied);
  EXPECT_EQ(thread.policy(), SCHED_DEADLINE | SCHED_RESET_ON_FORK);
}

TEST_F(SetScheduling, DoesNotTouchAThreadOfAnotherUser) {
  WaitingThread thread;
  EXPECT_EQ(
      set_scheduling({self, ::getpid(), ::geteuid() + 1}, thread.number(), policy(SCHED_BATCH))
          .setting,
      ThreadSetting::not_found);
  EXPECT_EQ(thread.policy(), SCHED_OTHER);
}

TEST_F(SetScheduling, DoesNotTouchAThreadThatHasEnded) {
  WaitingThread thread;
  thread.join();
  EXPECT_EQ(set(thread, policy(SCHED_BATCH)).setting, ThreadSetting::not_found);
}

TEST_F(SetScheduling, DoesNotTouchAThreadOfAnotherProcess) {
  const pid_t child = ::fork();
  if (child == 0) {
    for (;;) ::pause();
  }
  const Pidfd its = *Pidfd::open(child);
  const auto number = static_cast<std::uint32_t>(child);
  EXPECT_EQ(set_scheduling(mine(), number, policy(SCHED_BATCH)).setting, ThreadSetting::not_found);
  EXPECT_EQ(::sched_getscheduler(child), SCHED_OTHER);
  EXPECT_EQ(set_scheduling({its, child, ::geteuid()}, number, policy(SCHED_BATCH)).setting,
            ThreadSetting::applied);
  ::kill(child, SIGKILL);
  ::waitpid(child, nullptr, 0);
  EXPECT_EQ(set_scheduling({its, child, ::geteuid()}, number, policy(SCHED_BATCH)).setting,
            ThreadSetting::not_found);
}

}  // namespace
}  // namespace agnocast::daemon
