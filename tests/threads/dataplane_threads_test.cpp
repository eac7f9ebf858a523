// SPDX-License-Identifier: Apache-2.0
//
// Goal: the data plane orders memory correctly between real concurrent threads: no torn, stale,
// reused or missing message. Method: every "process" is a thread, every region a plain array; a
// publisher with a small heap, subscribers that take, hold and release at random, leave and join
// again. Payloads are poisoned when freed and verified at take and at release. Under
// ThreadSanitizer the payload accesses are ordinary memory accesses, so a missing acquire or
// release is a reported race.

#include <dataplane/publisher_core.hpp>
#include <dataplane/subscription_core.hpp>
#include <journal/board_steps.hpp>
#include <journal/start_steps.hpp>
#include <journal/verify.hpp>
#include <tests/support/memory/aligned_region.hpp>

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <deque>
#include <memory>
#include <mutex>
#include <random>
#include <thread>
#include <vector>

namespace agnocast::dataplane {
namespace {

using M = SharedMemory;

constexpr std::uint64_t extent = abi::page_bytes;
constexpr std::uint64_t generation = 3;
constexpr std::uint64_t payload_words = 24;
constexpr std::uint64_t poison = 0xdddddddddddddddd;

using Region = test::AlignedRegion;

struct Payload {
  std::uint64_t word[payload_words];
};

bool holds_message(const Payload& payload, std::uint64_t sequence) {
  for (std::uint64_t i = 0; i < payload_words; ++i) {
    if (payload.word[i] != sequence * 31 + i) return false;
  }
  return true;
}

struct Window {
  const Payload* first;
  std::uint64_t count;
  void open() const {}
  region::Place place_of(std::uint64_t address, std::uint64_t size) const {
    const auto begin = reinterpret_cast<std::uint64_t>(first);
    return address >= begin && address + size <= begin + count * sizeof(Payload)
               ? region::Place::readable
               : region::Place::outside;
  }
};

struct Scenario {
  const char* name;
  abi::Qos offered;
  std::vector<abi::Qos> requested;
  bool rejoin;
};

class World {
 public:
  explicit World(const Scenario& scenario) : scenario_(scenario), heap_(heap_count) {
    words().head().store(abi::pack_entry(first(), 0));
    journal::BoardSteps<M>(topic()).add_publisher(0, generation,
                                                  {scenario.offered, 0, extent, slots});
    for (std::uint64_t i = 0; i < heap_count; ++i) free_.push_back(i);
  }
  static std::uint64_t first() { return abi::first_sequence_of(generation); }
  region::TopicWords<M> topic() { return {board_.base(), 0}; }
  region::PublisherWords<M> words() { return {publisher_.base(), extent}; }

  void run(std::chrono::milliseconds time) {
    std::vector<std::thread> threads;
    for (std::uint64_t s = 0; s < scenario_.requested.size(); ++s)
      threads.emplace_back([this, s] { subscribe(s); });
    publish(time);
    for (std::thread& thread : threads) thread.join();
  }

  std::atomic<std::uint64_t> published{0}, taken{0}, lost{0}, joins{0}, full{0};

 private:
  static constexpr std::uint64_t slots = 256;
  static constexpr std::uint64_t heap_count = 300;

  struct Environment {
    World& world;
    void ring(std::uint64_t, std::uint64_t) {}
    void freed(std::uint64_t, std::uint64_t address) {
      Payload& payload = *reinterpret_cast<Payload*>(address);
      for (std::uint64_t& word : payload.word) word = poison;
      world.free_.push_back(static_cast<std::uint64_t>(&payload - world.heap_.data()));
    }
  };

  void publish(std::chrono::milliseconds time) {
    auto core = std::make_unique<PublisherCore<M>>(PublisherCore<M>::Identity{
        topic(), words(), 0, generation, first(), scenario_.offered, slots, 0});
    Environment environment{*this};
    const auto end = std::chrono::steady_clock::now() + time;
    while (std::chrono::steady_clock::now() < end) {
      {  // the control thread's work on announcements
        const std::lock_guard lock(control_);
        for (; !attach_.empty(); attach_.pop_front()) {
          core->attach(attach_.front().first, attach_.front().second,
                       subscriber_[attach_.front().first].base(), extent,
                       offsetof(abi::ClientRegionHeader, wait_set), attach_.front().first,
                       environment);
        }
        for (; !detach_.empty(); detach_.pop_front())
          core->detach(detach_.front().first, detach_.front().second);
      }
      if (free_.empty()) {
        core->scan(environment);
        std::this_thread::yield();
        continue;
      }
      const std::uint64_t block = free_.front();
      Payload& payload = heap_[block];
      const std::uint64_t sequence = core->head_sequence() + 1;
      for (std::uint64_t i = 0; i < payload_words; ++i) payload.word[i] = sequence * 31 + i;
      const auto outcome = core->publish(
          {reinterpret_cast<std::uint64_t>(&payload), sizeof payload, sequence}, environment);
      if (outcome != PublishOutcome::published) {
        ++full;
        std::this_thread::yield();
        continue;
      }
      free_.pop_front();
      ++published;
      if (published % 8 == 0) std::this_thread::yield();
    }
    stop_ = true;
    while (done_ < scenario_.requested.size()) core->scan(environment), std::this_thread::yield();
    core->scan(environment);
    core->scan(environment);
    const std::uint64_t history = scenario_.offered.transient_local ? scenario_.offered.depth : 0;
    EXPECT_LE(core->allocated_count(), history)
        << "messages stay allocated that no subscription can take";
    EXPECT_EQ(journal::verify_queue(words(), first(), slots, true), journal::Invariant::none);
  }

  void subscribe(std::uint64_t s) {
    std::mt19937_64 random(s + 1);
    std::uint64_t own_generation = 0;
    do {
      const region::LinkWords<M> line{subscriber_[s].base(), extent, 0};
      LinkCore<M> link({topic(), words(), line, 0, generation, first(), scenario_.offered,
                        scenario_.requested[s], sizeof(Payload), alignof(Payload)});
      {
        const std::lock_guard lock(control_);  // the daemon is one thread
        journal::BoardSteps<M>(topic()).add_subscription(s, ++own_generation,
                                                         {scenario_.requested[s], 1, extent, 8, 0});
        journal::set_start<M>(words(), line);
        attach_.emplace_back(s, own_generation);
      }
      ++joins;
      EXPECT_TRUE(link.link(false));
      std::deque<Taken> held;
      Window window{heap_.data(), heap_count};
      std::uint64_t last = 0, head = 0;
      const std::uint64_t stay = scenario_.rejoin ? 50 + random() % 200 : ~std::uint64_t{0};
      for (std::uint64_t i = 0; i < stay && !stop_; ++i) {
        if (held.size() < 5) {
          if (random() % 2 == 0 || !link.has_news(head)) head = link.look();  // else old look
          if (const auto found = link.take(window, head)) {
            EXPECT_GT(found->sequence, last);
            last = found->sequence;
            EXPECT_TRUE(
                holds_message(*reinterpret_cast<const Payload*>(found->address), found->sequence))
                << "at take";
            held.push_back(*found);
            ++taken;
          } else {
            std::this_thread::yield();
          }
        }
        if (!held.empty() && (held.size() == 5 || random() % 3 == 0)) release_oldest(link, held);
      }
      {
        const std::lock_guard lock(control_);
        journal::BoardSteps<M>(topic()).set_subscription(s, own_generation,
                                                         abi::BoardState::leaving);
      }
      while (!held.empty()) release_oldest(link, held);
      EXPECT_EQ(link.malformed(), 0u);
      lost += link.lost();
      link.unlink();
      const std::lock_guard lock(control_);
      journal::BoardSteps<M>(topic()).set_subscription(s, own_generation, abi::BoardState::free);
      detach_.emplace_back(s, own_generation);
    } while (!stop_);
    ++done_;
  }

  static void release_oldest(LinkCore<M>& link, std::deque<Taken>& held) {
    const Taken& oldest = held.front();
    EXPECT_TRUE(holds_message(*reinterpret_cast<const Payload*>(oldest.address), oldest.sequence))
        << "at release";
    link.release(oldest.slot);
    held.pop_front();
  }

  const Scenario& scenario_;
  Region board_{abi::topic_bytes};
  Region publisher_, subscriber_[4];
  std::vector<Payload> heap_;
  std::deque<std::uint64_t> free_;
  std::mutex control_;
  std::deque<std::pair<std::uint64_t, std::uint64_t>> attach_, detach_;
  std::atomic<bool> stop_{false};
  std::atomic<std::uint64_t> done_{0};
};

constexpr abi::Qos keep_last(std::uint32_t depth, bool transient_local = false) {
  return {depth, transient_local, true, false, false};
}

class DataplaneThreads : public testing::TestWithParam<Scenario> {};

TEST_P(DataplaneThreads, NeverReadFreedMemory) {
  World world(GetParam());
  world.run(std::chrono::milliseconds(1500));
  std::printf("%-32s %8llu published %8llu taken %8llu lost %6llu joins\n", GetParam().name,
              static_cast<unsigned long long>(world.published),
              static_cast<unsigned long long>(world.taken),
              static_cast<unsigned long long>(world.lost),
              static_cast<unsigned long long>(world.joins));
  EXPECT_GT(world.published, 100u);
  EXPECT_GT(world.taken, 100u);
  if (GetParam().offered.keep_all) {
    EXPECT_EQ(world.lost, 0u);
  }
}

INSTANTIATE_TEST_SUITE_P(
    Scenarios, DataplaneThreads,
    testing::Values(
        Scenario{"one deep reader", keep_last(1), {keep_last(20)}, false},
        Scenario{"shallow readers that lose", keep_last(1), {keep_last(1), keep_last(2)}, false},
        Scenario{"readers join and leave",
                 keep_last(4, true),
                 {keep_last(10), keep_last(2, true), keep_last(1)},
                 true},
        Scenario{
            "keep-all", {16, false, true, true, false}, {{8, false, true, true, false}}, false}),
    [](const auto& scenario) { return "scenario" + std::to_string(scenario.index); });

}  // namespace
}  // namespace agnocast::dataplane
