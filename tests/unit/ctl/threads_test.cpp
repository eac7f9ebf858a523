// SPDX-License-Identifier: Apache-2.0
//
// Goal: the scheduling of threads is read as the kernel has it, written in the words of Linux's
// tools, and compared with a rule without false alarms. Method: the functions alone; this test's
// own threads as the kernel shows them.

#include <ctl/snapshot/threads.hpp>

#include <gmock/gmock.h>

#include <sched.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdint>
#include <initializer_list>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::ctl {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using Numbers = std::vector<std::uint32_t>;

TEST(ThreadWords, WritesProcessorsAsTheKernelDoes) {
  EXPECT_EQ(cpu_list(Numbers{}), "");
  EXPECT_EQ(cpu_list(Numbers{0}), "0");
  EXPECT_EQ(cpu_list(Numbers{0, 1}), "0-1");
  EXPECT_EQ(cpu_list(Numbers{0, 1, 2, 3, 6}), "0-3,6");
  EXPECT_EQ(cpu_list(Numbers{1, 3, 5}), "1,3,5");
  EXPECT_EQ(cpu_list(Numbers{2, 62, 63, 64, 65, 1023}), "2,62-65,1023");
}

TEST(ThreadWords, NamesPoliciesAndWhatGoesWithThem) {
  EXPECT_EQ(policy_word(SCHED_OTHER), "other");
  EXPECT_EQ(policy_word(SCHED_FIFO), "fifo");
  EXPECT_EQ(policy_word(SCHED_RR), "rr");
  EXPECT_EQ(policy_word(SCHED_BATCH), "batch");
  EXPECT_EQ(policy_word(SCHED_IDLE), "idle");
  EXPECT_EQ(policy_word(SCHED_DEADLINE), "deadline");
  EXPECT_EQ(policy_word(4), "policy 4");
  EXPECT_EQ(policy_word(4'000'000'000), "policy 4000000000");
  KernelThread thread;
  thread.nice = -5;
  EXPECT_EQ(priority_words(thread), "nice -5");
  thread.policy = SCHED_RR;
  thread.priority = 50;
  EXPECT_EQ(priority_words(thread), "50");
  thread.policy = SCHED_DEADLINE;
  thread.runtime_ns = 2'000'000;
  thread.deadline_ns = 8'000'000;
  thread.period_ns = 10'000'000;
  EXPECT_EQ(priority_words(thread), "2.0 ms/8.0 ms/10.0 ms");
}

wire::ThreadScheduling with_cpus(std::initializer_list<std::uint32_t> cpus) {
  wire::ThreadScheduling scheduling{};
  scheduling.sets_cpus = 1;
  for (const std::uint32_t cpu : cpus) scheduling.cpus[cpu / 64] |= std::uint64_t{1} << cpu % 64;
  return scheduling;
}
wire::ThreadScheduling with_policy(std::uint32_t policy, std::uint32_t priority = 0) {
  wire::ThreadScheduling scheduling{};
  scheduling.sets_policy = 1;
  scheduling.policy = policy;
  scheduling.priority = priority;
  return scheduling;
}

TEST(ThreadDifference, ComparesOnlyWhatTheRuleSets) {
  KernelThread is;
  is.nice = 7;
  is.cpus = {0, 1};
  EXPECT_FALSE(difference_of({}, is));
  EXPECT_FALSE(difference_of(with_policy(SCHED_OTHER), is));
  EXPECT_FALSE(difference_of(with_cpus({0, 1}), is));
  auto nice = with_policy(SCHED_OTHER);
  nice.sets_nice = 1;
  nice.nice = -3;
  EXPECT_EQ(difference_of(nice, is).words, "nice 7 instead of -3");
  nice.nice = 7;
  EXPECT_FALSE(difference_of(nice, is));
}

TEST(ThreadDifference, ComparesThePriorityOfThePolicy) {
  KernelThread is;
  is.policy = SCHED_OTHER;
  EXPECT_EQ(difference_of(with_policy(SCHED_FIFO, 50), is).words, "policy other instead of fifo");
  is.policy = SCHED_FIFO;
  is.priority = 10;
  EXPECT_EQ(difference_of(with_policy(SCHED_FIFO, 50), is).words, "priority 10 instead of 50");
  is.priority = 50;
  auto both = with_policy(SCHED_FIFO, 50);
  EXPECT_FALSE(difference_of(both, is));
  both.sets_nice = 1;
  both.nice = -5;
  EXPECT_FALSE(difference_of(both, is)) << "the kernel gives no nice value for fifo";
}

TEST(ThreadDifference, ComparesNiceValuesOnlyWhereTheyCanBeSet) {
  wire::ThreadScheduling wanted{};
  wanted.sets_nice = 1;
  wanted.nice = 5;
  const auto differs = [&](std::uint32_t policy) {
    KernelThread is;
    is.policy = policy;
    return static_cast<bool>(difference_of(wanted, is));
  };
  EXPECT_TRUE(differs(SCHED_OTHER));
  EXPECT_TRUE(differs(SCHED_BATCH));
  EXPECT_FALSE(differs(SCHED_IDLE));
  EXPECT_FALSE(differs(SCHED_RR));
  EXPECT_FALSE(differs(SCHED_DEADLINE));
}

TEST(ThreadDifference, TakesAMissingPeriodForTheDeadline) {
  KernelThread is;
  is.policy = SCHED_DEADLINE;
  is.runtime_ns = 2'000'000;
  is.deadline_ns = is.period_ns = 10'000'000;
  auto wanted = with_policy(SCHED_DEADLINE);
  wanted.runtime_ns = 2'000'000;
  wanted.deadline_ns = 10'000'000;
  EXPECT_FALSE(difference_of(wanted, is));
  wanted.period_ns = 20'000'000;
  EXPECT_EQ(difference_of(wanted, is).words,
            "times 2.0 ms/10.0 ms/10.0 ms instead of 2.0 ms/10.0 ms/20.0 ms");
}

TEST(ThreadDifference, TellsMissingProcessorsFromOtherOnes) {
  KernelThread is;
  is.cpus = {0, 1};
  Difference difference = difference_of(with_cpus({0, 1, 2, 3}), is);
  EXPECT_EQ(difference.words, "processors 0-1 instead of 0-3");
  EXPECT_TRUE(difference.only_cpus_missing);
  difference = difference_of(with_cpus({1, 2}), is);
  EXPECT_EQ(difference.words, "processors 0-1 instead of 1-2");
  EXPECT_FALSE(difference.only_cpus_missing);
  auto wanted = with_cpus({0, 1, 2});
  wanted.sets_policy = 1;
  wanted.policy = SCHED_BATCH;
  difference = difference_of(wanted, is);
  EXPECT_EQ(difference.words, "policy other instead of batch, processors 0-1 instead of 0-2");
  EXPECT_FALSE(difference.only_cpus_missing);
  EXPECT_THAT(cpus_of(with_cpus({63, 64, 1023})), ElementsAre(63, 64, 1023));
  EXPECT_THAT(cpus_of({}), IsEmpty());
}

// --- the kernel

wire::DumpProcess this_process() {
  wire::DumpProcess process{};
  process.pid = static_cast<std::uint32_t>(::getpid());
  process.uid = ::geteuid();
  process.state = wire::ProcessState::connected;
  return process;
}

/// Changes its own scheduling, then waits for its destruction.
class OtherThread {
 public:
  template <class Change>
  explicit OtherThread(Change change)
      : thread_([this, change] {
          change();
          id_ = static_cast<std::uint32_t>(::syscall(SYS_gettid));
          id_.notify_one();
          ends_.wait(false);
        }) {
    id_.wait(0);
  }
  ~OtherThread() {
    ends_ = true;
    ends_.notify_one();
    thread_.join();
  }
  OtherThread(const OtherThread&) = delete;
  OtherThread& operator=(const OtherThread&) = delete;
  std::uint32_t id() const { return id_; }

 private:
  std::atomic<std::uint32_t> id_{0};
  std::atomic<bool> ends_{false};
  std::thread thread_;
};

TEST(ProcessThreads, ReadWhatTheKernelHas) {
  cpu_set_t allowed;
  CPU_ZERO(&allowed);
  ASSERT_EQ(::sched_getaffinity(0, sizeof allowed, &allowed), 0);
  std::uint32_t cpu = 0;
  while (!CPU_ISSET(cpu, &allowed)) ++cpu;
  const OtherThread thread([cpu] {
    cpu_set_t one;
    CPU_ZERO(&one);
    CPU_SET(cpu, &one);
    EXPECT_EQ(::sched_setaffinity(0, sizeof one, &one), 0);
    const sched_param none{};
    EXPECT_EQ(::sched_setscheduler(0, SCHED_BATCH | SCHED_RESET_ON_FORK, &none), 0);
    EXPECT_EQ(::setpriority(PRIO_PROCESS, 0, 7), 0);
    volatile unsigned work = 0;
    for (unsigned i = 0; i < 50'000'000; ++i) work = work + i;  // longer than one tick
  });
  const ProcessThreads threads(this_process());
  const auto is = threads.find(thread.id());
  ASSERT_TRUE(is.has_value());
  EXPECT_EQ(is->policy, static_cast<std::uint32_t>(SCHED_BATCH));
  EXPECT_EQ(is->nice, 7);
  EXPECT_TRUE(is->reset_on_fork);
  EXPECT_THAT(is->cpus, ElementsAre(cpu));
  EXPECT_GT(is->cpu_time_ns, 0u);
  const auto main = threads.find(static_cast<std::uint32_t>(::getpid()));
  ASSERT_TRUE(main.has_value());
  EXPECT_FALSE(main->reset_on_fork);
  EXPECT_EQ(main->cpus.size(), static_cast<std::size_t>(CPU_COUNT(&allowed)));
}

TEST(ProcessThreads, ShowNoThreadOfAnotherProcess) {
  std::uint32_t ended = 0;
  {
    const OtherThread thread([] {});
    ended = thread.id();
  }
  const ProcessThreads threads(this_process());
  EXPECT_FALSE(threads.find(ended).has_value());
  EXPECT_FALSE(threads.find(static_cast<std::uint32_t>(::getppid())).has_value());
  EXPECT_FALSE(threads.find(0x7fffffff).has_value());
  const std::uint32_t own = static_cast<std::uint32_t>(::getpid());
  auto process = this_process();
  process.uid += 1;
  EXPECT_FALSE(ProcessThreads(process).find(own).has_value()) << "another user's, so another one";
  process = this_process();
  process.pid = 0;
  EXPECT_FALSE(ProcessThreads(process).find(own).has_value()) << "in another pid namespace";
  process = this_process();
  process.state = wire::ProcessState::dead;
  EXPECT_FALSE(ProcessThreads(process).find(own).has_value());
}

TEST(ProcessThreads, HaveTheNumbersOfTheirOwnPidNamespace) {
  // As fork(), with a child that is process 1.
  const auto pid = static_cast<pid_t>(
      ::syscall(SYS_clone, CLONE_NEWPID | SIGCHLD, nullptr, nullptr, nullptr, nullptr));
  if (pid < 0) GTEST_SKIP() << "needs root: a pid namespace";
  if (pid == 0) {
    for (;;) ::pause();
  }
  auto process = this_process();
  process.pid = static_cast<std::uint32_t>(pid);
  const ProcessThreads threads(process);
  EXPECT_TRUE(threads.find(1).has_value());
  EXPECT_FALSE(threads.find(process.pid).has_value());
  ::kill(pid, SIGKILL);
  ::waitpid(pid, nullptr, 0);
}

// --- the threads of a system

void add_group(System& system, std::uint64_t client, std::uint64_t executor, std::uint64_t number) {
  CallbackGroup group;
  group.facts.client = client;
  group.facts.executor = executor;
  group.facts.group = number;
  system.callback_groups.push_back(group);
}
void add_thread(System& system, std::uint64_t client, std::uint32_t number,
                std::vector<std::uint64_t> executors) {
  ThreadFacts thread;
  thread.facts.client = client;
  thread.facts.thread = number;
  thread.facts.executor_count = static_cast<std::uint32_t>(executors.size());
  thread.executors = std::move(executors);
  system.callback_threads.push_back(thread);
}
Numbers groups_of(const CallbackThread& thread) {
  Numbers numbers;
  for (const CallbackGroup* const group : thread.groups)
    numbers.push_back(static_cast<std::uint32_t>(group->facts.group));
  return numbers;
}

TEST(ThreadsOfASystem, HaveTheGroupsOfAllTheirExecutors) {
  System system;
  for (const std::uint64_t client : {1u, 2u}) {
    Process& process = system.processes[client];
    process.facts.client = client;
    process.facts.domain = client;
  }
  add_group(system, 1, 0, 0);
  add_group(system, 1, 2, 1);
  add_group(system, 1, 2, 3);
  add_group(system, 1, 4, 2);
  add_group(system, 2, 2, 5);
  add_thread(system, 1, 10, {0});
  add_thread(system, 1, 11, {1});
  add_thread(system, 1, 12, {0, 2, 3});
  add_thread(system, 1, 13, {2, 4});
  add_thread(system, 2, 10, {0, 2});
  Arguments arguments;
  arguments.all_domains = true;
  const auto threads = threads_of(system, arguments);
  ASSERT_EQ(threads.size(), 5u);
  EXPECT_THAT(groups_of(threads[0]), ElementsAre(0));
  EXPECT_THAT(groups_of(threads[1]), IsEmpty());
  EXPECT_THAT(groups_of(threads[2]), ElementsAre(0, 1, 3));
  EXPECT_THAT(groups_of(threads[3]), ElementsAre(1, 3, 2));
  EXPECT_THAT(groups_of(threads[4]), ElementsAre(5));
  EXPECT_EQ(threads[3].group_count, 3u);
  EXPECT_THAT(threads[3].executors, ElementsAre(2, 4));
  EXPECT_EQ(threads[4].process, &system.processes[2]);
  EXPECT_FALSE(threads[0].kernel.has_value());
  arguments.all_domains = false;
  arguments.domain = 2;
  EXPECT_EQ(threads_of(system, arguments).size(), 1u);
}

TEST(ThreadsOfASystem, ShareTheGroupsAndExecutorsThatAreShown) {
  System system;
  system.processes[1].facts.client = 1;
  std::vector<std::uint64_t> all;
  for (std::uint64_t executor = 0; executor < abi::callback_group_count_max; ++executor) {
    add_group(system, 1, executor, abi::callback_group_count_max - executor);
    all.push_back(executor);
  }
  constexpr std::size_t share = 256, threads_count = shown_of_threads_max / share;
  constexpr std::size_t some = 100;
  const std::vector<std::uint64_t> few(all.begin(), all.begin() + some);
  for (std::uint32_t i = 1; i <= threads_count; ++i) add_thread(system, 1, i, i == 1 ? all : few);
  Arguments arguments;
  arguments.all_domains = true;
  const auto threads = threads_of(system, arguments);
  ASSERT_EQ(threads.size(), threads_count);
  EXPECT_EQ(threads[0].group_count, all.size());
  EXPECT_EQ(threads[0].facts->executor_count, all.size());
  EXPECT_EQ(threads[0].groups.size(), share);
  EXPECT_EQ(threads[0].executors.size(), share);
  EXPECT_EQ(threads[0].groups.back(), &system.callback_groups[share - 1]);
  for (const std::size_t other : {std::size_t{1}, threads_count - 1}) {
    EXPECT_EQ(threads[other].group_count, some);
    EXPECT_EQ(threads[other].groups.size(), some);
    EXPECT_EQ(threads[other].executors.size(), some);
  }
}

}  // namespace
}  // namespace agnocast::ctl
