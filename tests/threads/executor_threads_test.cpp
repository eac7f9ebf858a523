// SPDX-License-Identifier: Apache-2.0
//
// Goal: groups of callbacks move from executor to executor without a race, a lost wake-up, or two
// callbacks of an exclusive group at a time, with any number of threads; a thread that does not
// run them keeps sleeping.
// Method: the executors' core and background threads without daemon and client; a source of
// callbacks is a queue that threads of this test fill. They ring like a publisher: only an armed
// sleep word, once for each of its values, through the real doorbells. The test adds no
// synchronisation beyond what the code under test promises, so ThreadSanitizer sees what it lacks.

#include <client/executors/background_thread.hpp>
#include <client/executors/executor_core.hpp>
#include <tests/support/memory/aligned_region.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <mutex>
#include <random>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using test::eventually;
using M = SharedMemory;

constexpr std::uint64_t word_offset = offsetof(abi::ClientRegionHeader, wait_set);

/// A queue whose messages are taken without a consumer lock: the callbacks of one exclusive
/// group exclude each other, or this is a race.
class Queue final : public CallbackSource {
 public:
  explicit Queue(std::uint64_t size) : messages_(size) {}
  bool has_work() const noexcept override {
    return head_.load(std::memory_order_acquire) > taken_.load(std::memory_order_relaxed);
  }
  bool run_one() override {
    const std::uint64_t next = taken_.load(std::memory_order_relaxed);
    if (next == head_.load(std::memory_order_acquire)) return false;
    received.push_back(messages_[next]);  // not atomic, no lock
    taken_.store(next + 1, std::memory_order_release);
    return true;
  }
  void push(std::uint64_t message) {
    const std::uint64_t head = head_.load(std::memory_order_relaxed);
    messages_[head] = message;
    head_.store(head + 1, std::memory_order_release);
  }
  std::uint64_t taken() const { return taken_.load(std::memory_order_acquire); }

  std::vector<std::uint64_t> received;

 private:
  std::vector<std::uint64_t> messages_;
  std::atomic<std::uint64_t> head_{0}, taken_{0};
};

std::set<pid_t> callback_threads() {
  std::set<pid_t> all;
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::string name;
    std::getline(std::ifstream(task.path() / "comm"), name);
    if (name == "agnocast-call") all.insert(std::stoi(task.path().filename()));
  }
  return all;
}

/// A wait set, and the publishers that ring it.
struct TestWaitSet {
  TestWaitSet() : region(abi::page_bytes), eventfd(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
    int pair[2];
    if (::socketpair(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, pair) != 0) abort();
    datagram.reset(pair[1]);
    EXPECT_TRUE(wait_set->add(
        this, std::make_shared<WaitSet::Place>(
                  region.base(), 0,
                  DoorbellReceiver(UniqueFd(::dup(eventfd.get())), UniqueFd(pair[0])))));
  }
  std::uint64_t armed() {
    return M::word(region.base(), word_offset).load(std::memory_order_relaxed);
  }
  bool is_armed() { return armed() % 2 == 1; }

  test::AlignedRegion region;
  UniqueFd eventfd, datagram;
  std::shared_ptr<WaitSet> wait_set = WaitSet::make().value();
};

/// A publisher: it rings once for each value of the sleep word.
class Ringer {
 public:
  Ringer(TestWaitSet& waits, bool by_datagram) : waits_(waits), by_datagram_(by_datagram) {}
  /// P6, P8: after the commit.
  void ring() {
    M::fence();
    const std::uint64_t armed = waits_.armed();
    if (armed % 2 == 0 || armed == rung_) return;
    rung_ = armed;
    const std::uint64_t one = 1;
    if (by_datagram_) {
      (void)!::send(waits_.datagram.get(), "", 1, MSG_DONTWAIT);
    } else {
      (void)!::write(waits_.eventfd.get(), &one, sizeof one);
    }
  }

 private:
  TestWaitSet& waits_;
  const bool by_datagram_;
  std::uint64_t rung_ = 0;
};

/// A group with a wait set, its own or a shared one.
struct Group {
  explicit Group(CallbackGroupType type = CallbackGroupType::MutuallyExclusive,
                 std::shared_ptr<TestWaitSet> shared = std::make_shared<TestWaitSet>())
      : waits(std::move(shared)), callbacks(std::make_shared<GroupCallbacks>(type)) {
    callbacks->set_wait_set(waits->wait_set);
  }
  bool is_armed() { return waits->is_armed(); }
  void ring(bool by_datagram = false) { Ringer(*waits, by_datagram).ring(); }

  std::shared_ptr<TestWaitSet> waits;
  std::shared_ptr<GroupCallbacks> callbacks;
};

/// Returns how often a thread of this process has gone to sleep.
std::uint64_t sleeps_of(pid_t thread) {
  std::ifstream status("/proc/self/task/" + std::to_string(thread) + "/status");
  const std::string name = "voluntary_ctxt_switches:";
  for (std::string line; std::getline(status, line);) {
    if (line.rfind(name, 0) == 0) return std::stoull(line.substr(name.size()));
  }
  ADD_FAILURE() << "no thread " << thread;
  return 0;
}

/// Threads that spin one ExecutorCore, like Executor::spin().
struct Spinner {
  explicit Spinner(bool polls = false, int count = 1) : core(std::move(*ExecutorCore::make())) {
    core->share(count > 1);
    for (int i = 0; i < count; ++i) {
      threads.emplace_back([this, polls] {
        while (!core->is_cancelled()) {
          if (!core->run_next() && !polls) core->wait(std::nullopt);
        }
        core->leave();
      });
    }
  }
  ~Spinner() {
    core->cancel();
    for (std::thread& thread : threads) thread.join();
  }
  std::unique_ptr<ExecutorCore> core;
  std::vector<std::thread> threads;
};

/// A library thread that spins one.
struct Background {
  Background() : core(std::move(*ExecutorCore::make())) {
    const std::set<pid_t> before = callback_threads();
    thread = BackgroundThread::start(core).value();
    for (const pid_t number : callback_threads()) {
      if (before.count(number) == 0) thread_number = number;
    }
  }
  ~Background() { thread->join(); }
  std::shared_ptr<ExecutorCore> core;
  pid_t thread_number = 0;
  std::shared_ptr<BackgroundThread> thread;
};

TEST(ExecutorThreads, EverythingRunsOnceAndInOrderWhileExecutorsChange) {
  constexpr std::uint64_t count = 20000;
  Group group;
  Spinner sleeping, polling(true), several(false, 3);
  Background background;
  auto first = std::make_shared<Queue>(count), second = std::make_shared<Queue>(count);
  group.callbacks->add(first);
  group.callbacks->add(second);
  std::vector<std::thread> publishers;
  for (Queue* queue : {first.get(), second.get()}) {
    publishers.emplace_back([&group, queue, by_datagram = queue == second.get()] {
      Ringer ringer(*group.waits, by_datagram);
      for (std::uint64_t i = 0; i < count; ++i) {
        // In bursts: executors fall asleep in between.
        if (i % 500 == 0) std::this_thread::sleep_for(std::chrono::milliseconds(1));
        queue->push(i);
        ringer.ring();
      }
    });
  }
  EXPECT_TRUE(eventually([&] {
    for (ExecutorCore* core :
         {sleeping.core.get(), polling.core.get(), background.core.get(), several.core.get()}) {
      EXPECT_TRUE(core->adopt(group.callbacks));
      std::this_thread::sleep_for(std::chrono::microseconds(200));
      core->drop(*group.callbacks);
    }
    return first->taken() == count && second->taken() == count;
  }));
  for (std::thread& publisher : publishers) publisher.join();
  group.callbacks->remove(*first, nullptr);
  group.callbacks->remove(*second, nullptr);
  for (Queue* queue : {first.get(), second.get()}) {
    ASSERT_EQ(queue->received.size(), count);
    for (std::uint64_t i = 0; i < count; ++i) ASSERT_EQ(queue->received[i], i);
  }
}

// The safety timeout hides a lost wake-up for a second: so many lost ones do not fit into the
// deadline of these tests.
constexpr std::uint64_t rounds = 300;
std::chrono::steady_clock::time_point deadline_of_all_rounds() {
  return std::chrono::steady_clock::now() + std::chrono::seconds(60);
}

/// Waits for what may be true only briefly: an executor arms itself and looks again.
template <class Condition>
bool wait_for(std::chrono::steady_clock::time_point deadline, Condition condition) {
  while (!condition()) {
    if (std::chrono::steady_clock::now() > deadline) return false;
    std::this_thread::yield();
  }
  return true;
}

TEST(ExecutorThreads, EveryExecutorFallsAsleepAndIsWokenAfterAHandOver) {
  const auto deadline = deadline_of_all_rounds();
  Group group;
  Spinner one, several(false, 3);
  Background background;
  auto queue = std::make_shared<Queue>(rounds);
  group.callbacks->add(queue);
  for (std::uint64_t pushed = 0; pushed < rounds;) {
    ExecutorCore& core = pushed % 3 == 0   ? *one.core
                         : pushed % 3 == 1 ? *several.core
                                           : *background.core;
    ASSERT_TRUE(core.adopt(group.callbacks));
    ASSERT_TRUE(wait_for(deadline, [&] { return group.is_armed(); })) << pushed << " rounds";
    queue->push(pushed++);
    group.ring(pushed % 2 == 0);
    ASSERT_TRUE(wait_for(deadline, [&] { return queue->taken() == pushed; }))
        << pushed << " rounds";
    core.drop(*group.callbacks);
  }
}

// A ring wakes every executor that has a group there, and the socket that one of them empties
// must wake the others all the same.
// A creation has failed after this core got the group (the isolation model); the next one brings
// another wait set.
TEST(ExecutorThreads, AGroupIsRungByTheLastWaitSetThatItWasGiven) {
  auto core = std::move(ExecutorCore::make().value());
  Group group;
  const auto queue = std::make_shared<Queue>(1);
  group.callbacks->add(queue);
  ASSERT_TRUE(core->adopt(group.callbacks));
  ASSERT_FALSE(core->prepare());
  ASSERT_TRUE(group.is_armed());
  TestWaitSet next;
  group.callbacks->set_wait_set(next.wait_set);
  ASSERT_TRUE(core->listen(*group.callbacks, next.wait_set));
  EXPECT_FALSE(group.is_armed());
  core->finish_sleep();  // its wake-up
  ASSERT_FALSE(core->prepare());
  EXPECT_FALSE(group.is_armed());
  EXPECT_TRUE(next.is_armed());
  queue->push(7);
  Ringer(next, false).ring();
  epoll_event event{};
  EXPECT_EQ(::epoll_wait(core->fd(), &event, 1, 0), 1);
  core->finish_sleep();
  EXPECT_TRUE(core->run_next());
  EXPECT_EQ(queue->received, std::vector<std::uint64_t>{7});
  core->drop(*group.callbacks);
  EXPECT_FALSE(next.is_armed());
}

TEST(ExecutorThreads, ExecutorsThatShareAWaitSetAreAllWoken) {
  const auto deadline = deadline_of_all_rounds();
  const auto waits = std::make_shared<TestWaitSet>();
  constexpr auto type = CallbackGroupType::MutuallyExclusive;
  Group one(type, waits), other(type, waits);
  Spinner of_one, of_other(false, 2);
  auto first = std::make_shared<Queue>(rounds), second = std::make_shared<Queue>(rounds);
  one.callbacks->add(first);
  other.callbacks->add(second);
  ASSERT_TRUE(of_one.core->adopt(one.callbacks));
  ASSERT_TRUE(of_other.core->adopt(other.callbacks));
  Ringer by_eventfd(*waits, false), by_datagram(*waits, true);
  for (std::uint64_t pushed = 0; pushed < rounds;) {
    if (pushed % 4 < 2) {
      ASSERT_TRUE(wait_for(deadline, [&] { return one.is_armed(); })) << pushed << " rounds";
    }
    first->push(pushed);
    second->push(pushed++);
    (pushed % 2 == 0 ? by_datagram : by_eventfd).ring();
    ASSERT_TRUE(
        wait_for(deadline, [&] { return first->taken() == pushed && second->taken() == pushed; }))
        << first->taken() << " and " << second->taken() << " of " << pushed;
  }
  of_one.core->drop(*one.callbacks);
  of_other.core->drop(*other.callbacks);
}

/// Counts what it runs without any lock. Its callbacks take some time.
struct Counter final : CallbackSource {
  explicit Counter(bool is_serial = false) : CallbackSource(is_serial) {}
  std::atomic<std::uint64_t> wanted{0}, run{0};
  std::uint64_t unguarded = 0;
  bool has_work() const noexcept override { return run < wanted; }
  bool run_one() override {
    if (run >= wanted) return false;
    ++unguarded;
    if (unguarded % 3 == 0) std::this_thread::sleep_for(std::chrono::microseconds(50));
    ++run;
    return true;
  }
};

// Messages come at random moments, also while their group is busy: a group that becomes free with
// work must be seen by some thread, though nobody rings then.
TEST(ExecutorThreads, SeveralThreadsServeBusyGroupsWithoutALostWakeUp) {
  const auto deadline = deadline_of_all_rounds();
  constexpr std::size_t group_count = 4;
  Spinner several(false, 3);
  std::vector<std::unique_ptr<Group>> groups;
  std::vector<std::shared_ptr<Counter>> counters;
  for (std::size_t i = 0; i < group_count; ++i) {
    groups.push_back(std::make_unique<Group>());
    for (int of_group = 0; of_group < 2; ++of_group) {
      counters.push_back(std::make_shared<Counter>());
      groups.back()->callbacks->add(counters.back());
    }
    ASSERT_TRUE(several.core->adopt(groups.back()->callbacks));
  }
  std::minstd_rand random(7);
  for (std::uint64_t round = 1; round <= rounds; ++round) {
    for (std::size_t burst = 0; burst < 5; ++burst) {
      for (std::size_t i = 0; i < counters.size(); ++i) {
        if (random() % 2 == 0) continue;
        ++counters[i]->wanted;
        groups[i / 2]->ring(random() % 2 == 0);
      }
      if (random() % 2 == 0) std::this_thread::sleep_for(std::chrono::microseconds(random() % 100));
    }
    ASSERT_TRUE(wait_for(deadline,
                         [&] {
                           return std::all_of(
                               counters.begin(), counters.end(),
                               [](const auto& counter) { return counter->run == counter->wanted; });
                         }))
        << "after " << round << " rounds";
  }
  for (const auto& group : groups) several.core->drop(*group->callbacks);
  for (const auto& counter : counters) EXPECT_EQ(counter->unguarded, counter->wanted);
}

/// Waits in its callback until another one runs it as well.
struct Meeting final : CallbackSource {
  std::atomic<int> inside{0}, met{0};
  bool has_work() const noexcept override { return met < 2; }
  bool run_one() override {
    if (met >= 2) return false;
    ++inside;
    while (inside < 2 && met == 0) std::this_thread::yield();
    ++met;
    return true;
  }
};

TEST(ExecutorThreads, OneSourceOfAReentrantGroupRunsInTwoThreadsAtOnce) {
  Group group(CallbackGroupType::Reentrant);
  auto meeting = std::make_shared<Meeting>();
  group.callbacks->add(meeting);
  Spinner several(false, 2);
  ASSERT_TRUE(several.core->adopt(group.callbacks));
  EXPECT_TRUE(eventually([&] { return meeting->met >= 2; }));
  group.callbacks->remove(*meeting, nullptr);
  several.core->drop(*group.callbacks);
}

/// Runs once until the test lets it end, then once more in any executor.
struct Slow final : CallbackSource {
  std::atomic<std::uint64_t> begun{0}, ended{0};
  std::atomic<bool> may_end{false};
  bool has_work() const noexcept override { return begun < 2; }
  bool run_one() override {
    if (begun == 2) return false;
    ++begun;
    while (!may_end) std::this_thread::yield();
    ++ended;
    return true;
  }
};

TEST(ExecutorThreads, ANewExecutorContinuesWhenACallbackInTheOldOneHasEnded) {
  const auto deadline = deadline_of_all_rounds();
  Group group;
  Background background;
  Spinner spinner;
  for (std::uint64_t round = 0; round < rounds; ++round) {
    auto slow = std::make_shared<Slow>();
    group.callbacks->add(slow);
    ASSERT_TRUE(background.core->adopt(group.callbacks));
    while (slow->begun == 0) std::this_thread::yield();
    background.core->drop(*group.callbacks);
    ASSERT_TRUE(spinner.core->adopt(group.callbacks));
    while (!group.is_armed()) std::this_thread::yield();  // it has nothing to do until then
    EXPECT_EQ(slow->begun, 1u) << "one at a time";
    slow->may_end = true;
    ASSERT_TRUE(wait_for(deadline, [&] { return slow->ended == 2; })) << round << " rounds";
    group.callbacks->remove(*slow, nullptr);
    spinner.core->drop(*group.callbacks);
  }
}

TEST(ExecutorThreads, RemoveWaitsForTheCallbackInAnyExecutor) {
  Group group;
  Background background;
  Spinner spinner;
  auto slow = std::make_shared<Slow>();
  group.callbacks->add(slow);
  ASSERT_TRUE(background.core->adopt(group.callbacks));
  ASSERT_TRUE(eventually([&] { return slow->begun == 1; }));
  background.core->drop(*group.callbacks);
  ASSERT_TRUE(spinner.core->adopt(group.callbacks)) << "it moves while the callback runs";
  std::thread ender([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    slow->may_end = true;
  });
  group.callbacks->remove(*slow, nullptr);
  EXPECT_EQ(slow->ended, slow->begun);
  ender.join();
  auto queue = std::make_shared<Queue>(1);
  group.callbacks->add(queue);
  queue->push(1);
  group.ring();
  EXPECT_TRUE(eventually([&] { return queue->taken() == 1; })) << "the new executor continues";
  spinner.core->drop(*group.callbacks);
}

TEST(ExecutorThreads, AThreadWithoutGroupsSleepsThroughTheCallbacksOfOthers) {
  constexpr std::uint64_t count = 2000;
  Group group;
  auto queue = std::make_shared<Queue>(count);
  group.callbacks->add(queue);
  Background background;
  ASSERT_TRUE(background.core->adopt(group.callbacks));
  ASSERT_TRUE(eventually([&] { return group.is_armed(); })) << "it has slept as the executor";
  background.core->drop(*group.callbacks);
  Spinner spinner;
  ASSERT_TRUE(spinner.core->adopt(group.callbacks));
  const auto begin = std::chrono::steady_clock::now();
  const std::uint64_t before = sleeps_of(background.thread_number);
  for (std::uint64_t i = 0; i < count; ++i) {
    queue->push(i);
    group.ring();
    while (queue->taken() <= i) std::this_thread::yield();
  }
  const std::uint64_t sleeps = sleeps_of(background.thread_number) - before;
  const auto seconds =
      std::chrono::ceil<std::chrono::seconds>(std::chrono::steady_clock::now() - begin).count();
  EXPECT_LT(sleeps, count / 10 + static_cast<std::uint64_t>(seconds)) << "it ticks once a second";
  group.callbacks->remove(*queue, nullptr);
  spinner.core->drop(*group.callbacks);
}

TEST(ExecutorThreads, ACycleSeesSourcesAndGroupsThatCameAndWent) {
  Group one, other;
  const std::unique_ptr<ExecutorCore> core = std::move(*ExecutorCore::make());
  const auto full = [] {
    auto queue = std::make_shared<Queue>(100);
    for (std::uint64_t i = 0; i < 100; ++i) queue->push(i);
    return queue;
  };
  const auto run_cycle = [&] { return core->run_cycle(ExecutorCore::Clock::time_point::max()); };
  ASSERT_TRUE(core->adopt(one.callbacks));
  EXPECT_EQ(run_cycle(), 0u);
  const auto first = full(), second = full(), third = full();
  one.callbacks->add(first);
  EXPECT_EQ(run_cycle(), 1u) << "a source was added";
  EXPECT_EQ(run_cycle(), 1u) << "the same list again";
  one.callbacks->add(second);
  EXPECT_EQ(run_cycle(), 2u) << "another source was added";
  one.callbacks->remove(*first, nullptr);
  EXPECT_EQ(run_cycle(), 1u) << "the first source was removed";
  ASSERT_TRUE(core->adopt(other.callbacks));
  other.callbacks->add(third);
  EXPECT_EQ(run_cycle(), 1u) << "a group was added: the rest of the cycle";
  core->drop(*one.callbacks);
  EXPECT_EQ(run_cycle(), 1u) << "a group was removed";
  EXPECT_EQ(first->taken(), 3u);
  EXPECT_EQ(second->taken(), 2u);
  EXPECT_EQ(third->taken(), 2u);
  other.callbacks->remove(*third, nullptr);
  std::weak_ptr<Queue> gone;
  {
    const auto last = full();
    gone = last;
    other.callbacks->add(last);
    EXPECT_EQ(run_cycle(), 1u);
    other.callbacks->remove(*last, nullptr);
  }
  EXPECT_TRUE(gone.expired()) << "a list keeps nothing alive";
  EXPECT_EQ(run_cycle(), 0u);
  core->drop(*other.callbacks);
}

// The responses of a client are such a source.
TEST(ExecutorThreads, ASerialSourceRunsInOneThreadAtATimeInAReentrantGroup) {
  const auto deadline = deadline_of_all_rounds();
  Spinner several(false, 4);
  Group group(CallbackGroupType::Reentrant);
  const std::shared_ptr<Counter> counters[] = {std::make_shared<Counter>(true),
                                               std::make_shared<Counter>(true)};
  for (const auto& counter : counters) group.callbacks->add(counter);
  ASSERT_TRUE(several.core->adopt(group.callbacks));
  for (std::uint64_t round = 1; round <= rounds; ++round) {
    for (const auto& counter : counters) {
      counter->wanted += 10;
      group.ring(round % 2 == 0);
    }
    ASSERT_TRUE(wait_for(deadline, [&] {
      return counters[0]->run == counters[0]->wanted && counters[1]->run == counters[1]->wanted;
    })) << round;
  }
  for (const auto& counter : counters) {
    group.callbacks->remove(*counter, nullptr);
    EXPECT_EQ(counter->unguarded, counter->run);
  }
  several.core->drop(*group.callbacks);
}

/// Has work that it cannot do, as a subscription for whose message there is no memory.
struct Unable final : CallbackSource {
  bool has_work() const noexcept override { return true; }
  bool run_one() override { return false; }
};

TEST(ExecutorThreads, WorkThatNobodyCanDoKeepsNoThread) {
  Group group;
  group.callbacks->add(std::make_shared<Unable>());
  const auto core = std::move(*ExecutorCore::make());
  core->share(true);
  ASSERT_TRUE(core->adopt(group.callbacks));
  EXPECT_FALSE(core->run_next());
  core->drop(*group.callbacks);
}

}  // namespace
}  // namespace agnocast
