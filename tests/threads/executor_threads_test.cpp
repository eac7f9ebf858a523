// SPDX-License-Identifier: Apache-2.0
//
// Goal: a node's callbacks move from executor to executor without a race, a lost wake-up, or two
// callbacks at a time; a thread that does not run them keeps sleeping. Method: the executors' core
// and the library's thread without daemon and client; a source of callbacks is a queue that
// threads of this test fill. They ring like a publisher: only an armed sleep word, through the
// real doorbells. The test adds no synchronisation beyond what the code under test promises, so
// ThreadSanitizer sees what it lacks.

#include <client/executors/executor_core.hpp>
#include <client/executors/node_thread.hpp>
#include <tests/support/memory/aligned_region.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using test::eventually;
using M = SharedMemory;

constexpr std::uint64_t word_offset = offsetof(abi::ClientRegionHeader, executor);

/// A queue whose messages are taken without a consumer lock: the callbacks of one node exclude
/// each other, or this is a race.
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

/// A node with its library thread.
struct Node {
  Node() : region(abi::page_bytes), eventfd(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
    int pair[2];
    if (::socketpair(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, pair) != 0) abort();
    datagram.reset(pair[1]);
    callbacks = std::make_shared<NodeCallbacks>("/node", WaitSet::make().value());
    EXPECT_TRUE(callbacks->wait_set()->add(
        this, std::make_shared<WaitSet::Place>(
                  region.base(), 0,
                  DoorbellReceiver(UniqueFd(::dup(eventfd.get())), UniqueFd(pair[0])))));
    const std::set<pid_t> before = callback_threads();
    thread = NodeThread::start(callbacks).value();
    for (const pid_t number : callback_threads()) {
      if (before.count(number) == 0) thread_number = number;
    }
    callbacks->hand_to(callbacks.get());
  }
  ~Node() {
    callbacks->stop();
    thread->join();
  }
  bool is_armed() {
    return M::word(region.base(), word_offset).load(std::memory_order_relaxed) % 2 == 1;
  }
  /// P6, P8: after the commit.
  void ring(bool by_datagram) {
    M::fence();
    if (!is_armed()) return;
    const std::uint64_t one = 1;
    if (by_datagram) {
      (void)!::send(datagram.get(), "", 1, MSG_DONTWAIT);
    } else {
      (void)!::write(eventfd.get(), &one, sizeof one);
    }
  }

  test::AlignedRegion region;
  UniqueFd eventfd, datagram;
  std::shared_ptr<NodeCallbacks> callbacks;
  std::atomic<pid_t> thread_number{0};
  std::shared_ptr<NodeThread> thread;
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

/// A spinning thread on an ExecutorCore, like Executor::spin().
struct Spinner {
  explicit Spinner(bool polls) : core(std::move(*ExecutorCore::make())) {
    thread = std::thread([this, polls] {
      while (!core->take_cancel()) {
        if (core->run_next()) continue;
        if (!polls && !core->prepare()) core->sleep(std::nullopt);
      }
    });
  }
  ~Spinner() {
    core->cancel();
    thread.join();
  }
  std::unique_ptr<ExecutorCore> core;
  std::thread thread;
};

TEST(ExecutorThreads, EverythingRunsOnceAndInOrderWhileExecutorsChange) {
  constexpr std::uint64_t count = 20000;
  Node node;
  Spinner sleeping(false), polling(true);
  auto first = std::make_shared<Queue>(count), second = std::make_shared<Queue>(count);
  node.callbacks->add(first);
  node.callbacks->add(second);
  std::vector<std::thread> publishers;
  for (Queue* queue : {first.get(), second.get()}) {
    publishers.emplace_back([&node, queue, by_datagram = queue == second.get()] {
      for (std::uint64_t i = 0; i < count; ++i) {
        // In bursts: executors fall asleep in between.
        if (i % 500 == 0) std::this_thread::sleep_for(std::chrono::milliseconds(1));
        queue->push(i);
        node.ring(by_datagram);
      }
    });
  }
  EXPECT_TRUE(eventually([&] {
    for (Spinner* spinner : {&sleeping, &polling, &sleeping}) {
      EXPECT_TRUE(spinner->core->adopt(node.callbacks));
      std::this_thread::sleep_for(std::chrono::microseconds(200));
      spinner->core->drop(*node.callbacks);
      node.callbacks->hand_to(node.callbacks.get());
    }
    return first->taken() == count && second->taken() == count;
  }));
  for (std::thread& publisher : publishers) publisher.join();
  node.callbacks->remove(*first, nullptr);
  node.callbacks->remove(*second, nullptr);
  for (Queue* queue : {first.get(), second.get()}) {
    ASSERT_EQ(queue->received.size(), count);
    for (std::uint64_t i = 0; i < count; ++i) ASSERT_EQ(queue->received[i], i);
  }
}

// The safety timeout hides a lost wake-up for a second: so many lost ones do not fit into the
// deadline of the next two tests.
constexpr std::uint64_t rounds = 300;
std::chrono::steady_clock::time_point deadline_of_all_rounds() {
  return std::chrono::steady_clock::now() + std::chrono::seconds(60);
}

TEST(ExecutorThreads, EveryExecutorFallsAsleepAndIsWokenAfterAHandOver) {
  const auto deadline = deadline_of_all_rounds();
  const auto wait_for = [&](auto condition) {
    while (!condition()) {  // may be true only briefly: an executor arms itself and looks again
      if (std::chrono::steady_clock::now() > deadline) return false;
      std::this_thread::yield();
    }
    return true;
  };
  Node node;
  Spinner one(false), other(false);
  auto queue = std::make_shared<Queue>(rounds);
  node.callbacks->add(queue);
  for (std::uint64_t pushed = 0; pushed < rounds;) {
    Spinner* const spinner = pushed % 3 == 0 ? &one : pushed % 3 == 1 ? &other : nullptr;
    if (spinner != nullptr) {
      EXPECT_TRUE(spinner->core->adopt(node.callbacks));
    } else {
      node.callbacks->hand_to(node.callbacks.get());
    }
    ASSERT_TRUE(wait_for([&] { return node.is_armed(); })) << "after " << pushed << " rounds";
    queue->push(pushed++);
    node.ring(pushed % 2 == 0);
    ASSERT_TRUE(wait_for([&] { return queue->taken() == pushed; }))
        << "after " << pushed << " rounds";
    if (spinner != nullptr) spinner->core->drop(*node.callbacks);
  }
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
  Node node;
  Spinner spinner(false);
  for (std::uint64_t round = 0; round < rounds; ++round) {
    auto slow = std::make_shared<Slow>();
    node.callbacks->add(slow);
    while (slow->begun == 0) std::this_thread::yield();
    ASSERT_TRUE(spinner.core->adopt(node.callbacks));
    while (!node.is_armed()) std::this_thread::yield();  // it has nothing to do until then
    EXPECT_EQ(slow->begun, 1u) << "one at a time";
    slow->may_end = true;
    while (slow->ended != 2) {
      ASSERT_LT(std::chrono::steady_clock::now(), deadline) << "after " << round << " rounds";
      std::this_thread::yield();
    }
    node.callbacks->remove(*slow, nullptr);
    spinner.core->drop(*node.callbacks);
    node.callbacks->hand_to(node.callbacks.get());
  }
}

TEST(ExecutorThreads, RemoveWaitsForTheCallbackInAnyExecutor) {
  Node node;
  Spinner spinner(false);
  auto slow = std::make_shared<Slow>();
  node.callbacks->add(slow);
  ASSERT_TRUE(eventually([&] { return slow->begun == 1; })) << "in the library's thread";
  ASSERT_TRUE(spinner.core->adopt(node.callbacks)) << "the node moves while the callback runs";
  std::thread ender([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    slow->may_end = true;
  });
  node.callbacks->remove(*slow, nullptr);
  EXPECT_EQ(slow->ended, slow->begun);
  ender.join();
  auto queue = std::make_shared<Queue>(1);
  node.callbacks->add(queue);
  queue->push(1);
  node.ring(false);
  EXPECT_TRUE(eventually([&] { return queue->taken() == 1; })) << "the new executor continues";
  spinner.core->drop(*node.callbacks);
}

TEST(ExecutorThreads, AThreadThatIsNotTheExecutorSleepsThroughTheCallbacks) {
  constexpr std::uint64_t count = 2000;
  Node node;
  auto queue = std::make_shared<Queue>(count);
  node.callbacks->add(queue);
  ASSERT_TRUE(eventually([&] { return node.is_armed(); })) << "the library's thread has started";
  Spinner spinner(false);
  ASSERT_TRUE(spinner.core->adopt(node.callbacks));
  queue->push(0);
  ASSERT_TRUE(eventually([&] { return node.ring(false), queue->taken() == 1; }));
  // Its last sleep as the executor is over, and it waits to be the executor again.
  std::uint64_t before = sleeps_of(node.thread_number);
  EXPECT_TRUE(eventually([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    return sleeps_of(node.thread_number) == std::exchange(before, sleeps_of(node.thread_number));
  }));
  for (std::uint64_t i = 1; i < count; ++i) {
    queue->push(i);
    node.ring(false);
    while (queue->taken() <= i) std::this_thread::yield();
  }
  EXPECT_LT(sleeps_of(node.thread_number) - before, count / 100);
  node.callbacks->remove(*queue, nullptr);
  spinner.core->drop(*node.callbacks);
}

TEST(ExecutorThreads, ACycleSeesSourcesAndNodesThatCameAndWent) {
  Node one, other;
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
  EXPECT_EQ(run_cycle(), 2u) << "a node was added";
  core->drop(*one.callbacks);
  EXPECT_EQ(run_cycle(), 1u) << "a node was removed";
  EXPECT_EQ(first->taken(), 3u);
  EXPECT_EQ(second->taken(), 3u);
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

}  // namespace
}  // namespace agnocast
