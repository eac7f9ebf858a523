// SPDX-License-Identifier: Apache-2.0
//
// Goal: in the steady state publish, take, release, borrow and filling a message make no system
// calls; a publish makes one per sleeping receiver for one and two of them, and three when there
// are more. Method: a process of syscall_subject is traced
// (tests/support/machine/syscall_tracer.hpp) and marks the counted sections. "Asleep" is made
// certain: a signal stops a receiver while its callback thread is inside epoll_wait, so it stays
// armed until it is continued. Growth of the heap is counted apart.
//
// One call is allowed now and then: a futex, when the process's own control thread has the
// publisher's private mutex during a reclamation scan.

#include <tests/support/machine/syscall_tracer.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/steered_process.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

constexpr std::uint64_t label_fill = 1, label_publish = 2, label_growth = 3, label_take = 4,
                        label_release = 5, label_none = 6, label_clock = 7;

class Syscalls : public testing::Test {
 protected:
  std::unique_ptr<SteeredProcess> subject(bool may_publish) {
    std::vector<std::string> variables{"AGNOCAST_SOCKET=" + daemon_.socket_path()};
    if (may_publish) variables.push_back("LD_PRELOAD=" AGNOCAST_HOOK);
    return std::make_unique<SteeredProcess>(std::vector<std::string>{AGNOCAST_SUBJECT}, variables);
  }

  /// Returns the calls of a traced process while it executed `line`, by label and section.
  static std::map<std::uint64_t, std::vector<std::vector<long>>> trace(SteeredProcess& process,
                                                                       SyscallTracer& tracer,
                                                                       const std::string& line,
                                                                       std::size_t sections) {
    std::map<std::uint64_t, std::vector<std::vector<long>>> all;
    EXPECT_EQ(process.ask(line), "ok") << line;
    for (std::size_t i = 0; i < sections; ++i) {
      const auto section = tracer.next();
      if (!section) {
        ADD_FAILURE() << "the trace ended";
        break;
      }
      all[section->label].push_back(section->calls);
    }
    return all;
  }

  /// Expects no call at all except the rare futex; returns the number of futexes.
  static std::size_t expect_silence(const std::vector<std::vector<long>>& sections) {
    std::size_t futexes = 0;
    for (const auto& calls : sections) {
      for (const long call : calls) {
        EXPECT_EQ(call, SYS_futex);
        ++futexes;
      }
    }
    return futexes;
  }

  DaemonProcess daemon_;
};

/// A process whose callback thread sleeps; stopped, it stays asleep.
class WaitSet {
 public:
  explicit WaitSet(std::unique_ptr<SteeredProcess> process) : process_(std::move(process)) {
    EXPECT_EQ(process_->ask("callback"), "ok");
  }
  SteeredProcess& process() { return *process_; }
  ~WaitSet() { wake(); }
  WaitSet(const WaitSet&) = delete;
  WaitSet& operator=(const WaitSet&) = delete;

  [[nodiscard]] bool stop_asleep() {
    return eventually([&] {
      if (!is_asleep()) return false;
      ::kill(process_->pid(), SIGSTOP);
      if (eventually([&] { return is_stopped(); }) && is_asleep()) return true;
      wake();
      return false;
    });
  }
  void wake() { ::kill(process_->pid(), SIGCONT); }

 private:
  std::string task() const {
    const std::string tasks = "/proc/" + std::to_string(process_->pid()) + "/task";
    for (const auto& entry : std::filesystem::directory_iterator(tasks)) {
      std::string name;
      std::getline(std::ifstream(entry.path() / "comm"), name);
      if (name == "agnocast-call") return entry.path();
    }
    return "/nowhere";
  }
  bool is_asleep() const {
    long call = -1;
    std::ifstream(task() + "/syscall") >> call;
    if (call == SYS_epoll_pwait) return true;
#ifdef SYS_epoll_wait
    return call == SYS_epoll_wait;
#else
    return false;
#endif
  }
  bool is_stopped() const {
    std::string pid, name, state;
    std::ifstream(task() + "/stat") >> pid >> name >> state;
    return state == "T";
  }
  std::unique_ptr<SteeredProcess> process_;
};

TEST_F(Syscalls, PublishTakeAndReleaseMakeNoneOnceWarm) {
  auto publisher = subject(true), subscriber = subject(false);
  ASSERT_EQ(subscriber->ask("sub"), "ok");
  ASSERT_EQ(publisher->ask("pub"), "ok");
  ASSERT_TRUE(publisher->eventually("subs", "1") && subscriber->eventually("pubs", "1"));
  SyscallTracer tracer(publisher->pid()), other(subscriber->pid());
  if (tracer.is_forbidden() || other.is_forbidden())
    GTEST_SKIP() << "tracing needs CAP_SYS_PTRACE here, or kernel.yama.ptrace_scope = 0";
  ASSERT_TRUE(tracer.is_tracing() && other.is_tracing());

  std::size_t clock = trace(*publisher, tracer, "clock", 1)[label_clock][0].size();
  if (clock != 0)
    GTEST_SKIP() << "reading the clock is a system call here: no vDSO for its clock source";

  std::size_t futexes = 0;
  const auto begin = std::chrono::steady_clock::now();
  for (int round = 0; round < 55; ++round) {
    auto calls = trace(*publisher, tracer, "publish 40 0", 80);
    auto taken = trace(*subscriber, other, "take 40", 80);
    auto none = trace(*subscriber, other, "none", 1);
    if (round < 5) continue;  // until heap, thread caches and mappings are warm
    ASSERT_EQ(calls[label_fill].size(), 40u);
    futexes += expect_silence(calls[label_fill]) + expect_silence(calls[label_publish]) +
               expect_silence(taken[label_take]) + expect_silence(taken[label_release]) +
               expect_silence(none[label_none]);
  }
  std::printf("2000 messages filled, published, taken, released: %zu futexes, no other call\n",
              futexes);
  // A control thread scans once a second, and each process's may be met in that: a wait for the
  // mutex, and a wake of the next one.
  const auto seconds =
      std::chrono::ceil<std::chrono::seconds>(std::chrono::steady_clock::now() - begin).count();
  EXPECT_LE(futexes, 20 + 4 * static_cast<std::size_t>(seconds))
      << "the control threads hold the mutex too often";
}

TEST_F(Syscalls, PublishMakesOneForEachOfTwoSleepingReceiversAndThreeForMore) {
  auto publisher = subject(true);
  ASSERT_EQ(publisher->ask("pub"), "ok");
  SyscallTracer tracer(publisher->pid());
  if (tracer.is_forbidden())
    GTEST_SKIP() << "tracing needs CAP_SYS_PTRACE here, or kernel.yama.ptrace_scope = 0";
  ASSERT_TRUE(tracer.is_tracing());
  ASSERT_EQ(publisher->ask("publish 50 0"), "ok");
  for (int i = 0; i < 100; ++i) ASSERT_TRUE(tracer.next());

  std::vector<std::unique_ptr<WaitSet>> wait_sets;
  std::vector<std::uint64_t> received;
  for (const std::size_t count : {1u, 2u, 3u, 6u}) {
    while (wait_sets.size() < count) {
      wait_sets.push_back(std::make_unique<WaitSet>(subject(false)));
      received.push_back(0);
    }
    ASSERT_TRUE(publisher->eventually("subs", std::to_string(count)));
    for (int repetition = 0; repetition < 10; ++repetition) {
      for (const auto& wait_set : wait_sets) ASSERT_TRUE(wait_set->stop_asleep());
      auto calls = trace(*publisher, tracer, "publish 1 0", 2)[label_publish][0];
      std::erase(calls, SYS_futex);
      EXPECT_THAT(calls, testing::Each(SYS_write));
      EXPECT_EQ(calls.size(), std::min<std::size_t>(count, 3)) << count << " sleeping receivers";
      // A publish rings each sleeping receiver once.
      calls = trace(*publisher, tracer, "publish 1 0", 2)[label_publish][0];
      std::erase(calls, SYS_futex);
      EXPECT_LE(calls.size(), count > 2 ? 1u : 0u) << "already rung";
      for (std::size_t i = 0; i < wait_sets.size(); ++i) {
        wait_sets[i]->wake();
        received[i] += 2;
        EXPECT_TRUE(wait_sets[i]->process().eventually("received", std::to_string(received[i])))
            << "receiver " << i << " of " << count;
      }
    }
  }
}

TEST_F(Syscalls, GrowthOfTheHeapMapsMemoryAndWakesTheControlThread) {
  auto publisher = subject(true), subscriber = subject(false);
  ASSERT_EQ(subscriber->ask("sub"), "ok");
  ASSERT_EQ(publisher->ask("pub"), "ok");
  ASSERT_TRUE(publisher->eventually("subs", "1") && subscriber->eventually("pubs", "1"));
  SyscallTracer tracer(publisher->pid()), other(subscriber->pid());
  if (tracer.is_forbidden() || other.is_forbidden())
    GTEST_SKIP() << "tracing needs CAP_SYS_PTRACE here, or kernel.yama.ptrace_scope = 0";
  ASSERT_TRUE(tracer.is_tracing() && other.is_tracing());
  auto grown = trace(*publisher, tracer, "publish 1 8000000", 2)[label_growth];
  auto taken = trace(*subscriber, other, "take 1", 2)[label_take];
  std::vector<long> calls = grown[0];
  calls.insert(calls.end(), grown[1].begin(), grown[1].end());
  EXPECT_FALSE(calls.empty()) << "8 MB do not fit into the initially mapped memory";
  const std::set<long> of_memory{SYS_mmap,      SYS_munmap,   SYS_madvise, SYS_mprotect,
                                 SYS_fallocate, SYS_futex,    SYS_fstat,   SYS_newfstatat,
                                 SYS_ftruncate, SYS_prlimit64};
  std::size_t wakes = 0;
  for (const long call : calls) {
    if (call == SYS_write) {
      ++wakes;  // the control thread learns that the heap has grown
    } else {
      EXPECT_EQ(of_memory.count(call), 1u) << "system call " << call;
    }
  }
  EXPECT_LE(wakes, calls.size() / 2);
  for (const long call : taken[0]) EXPECT_EQ(of_memory.count(call), 1u) << "system call " << call;
  EXPECT_GE(taken[0].size(), 1u);
  std::printf("growth for one message of 8 MB: %zu calls of the publisher, %zu of the subscriber\n",
              calls.size(), taken[0].size());
}

}  // namespace
}  // namespace agnocast::test
