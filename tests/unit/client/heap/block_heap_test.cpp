// SPDX-License-Identifier: Apache-2.0
//
// Goal: blocks of the heap without the hook are aligned, disjoint and inside the announced part of
// the windows; freed memory is used again, and goes back to the system. Method: windows made by the
// test; each test runs in a child, because a process has one such heap. A model of all live blocks,
// each with its own pattern, judges random allocations.

#include <agnocast/abi/limits.hpp>
#include <base/memory/memfd.hpp>
#include <client/heap/block_heap.hpp>

#include <gtest/gtest.h>

#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <map>
#include <random>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

constexpr std::size_t test_window_bytes = 8 * abi::window_granule_bytes;

std::atomic<std::uint64_t> announced[AGNOCAST_HEAPHOOK_WINDOWS_MAX];

struct TestWindow {
  std::byte* base = nullptr;
  UniqueFd file, reader;

  agnocast_heaphook_window described(std::uint32_t flags = 0) const {
    return {base, test_window_bytes, file.get(), reader.get(), flags, 0};
  }
  std::uint64_t allocated() const {
    struct stat status {};
    EXPECT_EQ(::fstat(file.get(), &status), 0);
    return static_cast<std::uint64_t>(status.st_blocks) * 512;
  }
};

/// `count`: the addresses of so many windows are free there.
TestWindow make_window(std::size_t count = 1) {
  TestWindow window;
  window.file = make_memfd("block_heap_test", test_window_bytes).value();
  window.reader = reopen_read_only(window.file.get()).value();
  const std::size_t bytes = count * test_window_bytes + abi::window_granule_bytes;
  void* const room = ::mmap(nullptr, bytes, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  const auto address = reinterpret_cast<std::uintptr_t>(room);
  ::munmap(room, bytes);
  window.base = reinterpret_cast<std::byte*>((address + abi::window_granule_bytes - 1) /
                                             abi::window_granule_bytes * abi::window_granule_bytes);
  return window;
}

std::uint64_t page_bytes() { return static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE)); }

const agnocast_heaphook_table& heap() { return block_heap(); }

agnocast_heaphook_usage usage() {
  agnocast_heaphook_usage usage{};
  heap().usage(&usage);
  return usage;
}

void attach(const TestWindow& window) {
  const auto described = window.described();
  const agnocast_heaphook_options options{
      AGNOCAST_HEAPHOOK_SCOPE_LOAN, 0,
      [](void*, std::uint32_t number, std::uint64_t bytes) { announced[number].store(bytes); },
      nullptr};
  EXPECT_EQ(heap().attach(&described, &options), AGNOCAST_HEAPHOOK_OK);
  EXPECT_EQ(heap().attach(&described, &options), AGNOCAST_HEAPHOOK_STATE) << "once";
}

TestWindow attached() {
  TestWindow window = make_window();
  attach(window);
  return window;
}

/// Runs the test in a child, whose failed expectations are this process's.
void in_child(const std::function<void()>& test) {
  std::fflush(nullptr);
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    test();
    std::fflush(nullptr);
    ::_exit(testing::Test::HasFailure() ? 1 : 0);
  }
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << "status " << status;
}

bool is_within(const TestWindow& window, const void* block, std::size_t bytes, std::uint64_t end) {
  const auto offset = static_cast<const std::byte*>(block) - window.base;
  return offset >= 0 && static_cast<std::uint64_t>(offset) + bytes <= end;
}

TEST(BlockHeap, IsInertBeforeItHasAWindow) {
  in_child([] {
    EXPECT_EQ(heap().allocate(16, 100), nullptr);
    int mine = 0;
    EXPECT_EQ(heap().deallocate(&mine), 0);
    EXPECT_EQ(heap().owns(&mine), 0);
    EXPECT_EQ(heap().purge(), 0U);
    EXPECT_EQ(heap().idle(), 0U);
    EXPECT_EQ(usage().window_count, 0U);
    const TestWindow window = make_window();
    const auto described = window.described();
    EXPECT_EQ(heap().add_window(&described), AGNOCAST_HEAPHOOK_STATE);
  });
}

TEST(BlockHeap, HasAlignedDisjointBlocksInTheAnnouncedPart) {
  in_child([] {
    const TestWindow window = attached();
    std::mt19937_64 random(1);
    struct Block {
      std::size_t bytes;
      std::uint8_t pattern;
    };
    std::map<std::byte*, Block> live;
    const auto free_one = [&](std::map<std::byte*, Block>::iterator at) {
      for (std::size_t i = 0; i < at->second.bytes; ++i)
        ASSERT_EQ(at->first[i], std::byte{at->second.pattern});
      EXPECT_EQ(heap().deallocate(at->first), 1);
      live.erase(at);
    };
    for (int i = 0; i < 4'000 && !testing::Test::HasFailure(); ++i) {
      if (live.size() > 60 || (!live.empty() && random() % 2 == 0)) {
        free_one(std::next(live.begin(), static_cast<std::ptrdiff_t>(random() % live.size())));
        continue;
      }
      const std::size_t bytes = 1 + random() % (random() % 8 == 0 ? 100'000 : 3'000);
      const std::size_t alignment = std::size_t{1} << random() % 14;
      auto* const block = static_cast<std::byte*>(heap().allocate(alignment, bytes));
      ASSERT_NE(block, nullptr) << "these blocks always fit";
      EXPECT_EQ(reinterpret_cast<std::uintptr_t>(block) % alignment, 0U);
      ASSERT_TRUE(is_within(window, block, bytes, announced[0].load()));
      EXPECT_EQ(heap().owns(block), 1);
      const auto next = live.lower_bound(block);
      if (next != live.end()) EXPECT_LE(block + bytes, next->first);
      if (next != live.begin()) {
        const auto before = std::prev(next);
        EXPECT_LE(before->first + before->second.bytes, block);
      }
      const auto pattern = static_cast<std::uint8_t>(random());
      std::memset(block, pattern, bytes);
      live.emplace(block, Block{bytes, pattern});
      if (i % 500 == 0) heap().purge();
    }
    EXPECT_GT(usage().live_bytes, 0U);
    while (!live.empty() && !testing::Test::HasFailure()) free_one(live.begin());
    EXPECT_EQ(usage().live_bytes, 0U);
    EXPECT_EQ(usage().internal_error_count, 0U);
    heap().purge();
    EXPECT_LE(window.allocated(), page_bytes()) << "all but the page of the end";
    // Freed neighbours have joined.
    void* const all = heap().allocate(64, test_window_bytes);
    EXPECT_EQ(all, window.base);
    EXPECT_EQ(heap().deallocate(all), 1);
  });
}

TEST(BlockHeap, UsesFreedMemoryBeforeItGrows) {
  in_child([] {
    const TestWindow window = attached();
    void* const first = heap().allocate(64, 1000);
    void* const second = heap().allocate(64, 1000);
    EXPECT_EQ(heap().deallocate(first), 1);
    EXPECT_EQ(heap().allocate(64, 900), first);
    const std::uint64_t used = usage().used_bytes;
    for (int i = 0; i < 1000; ++i) {
      void* const block = heap().allocate(64, 5000);
      ASSERT_NE(block, nullptr);
      heap().deallocate(block);
    }
    EXPECT_LE(usage().used_bytes, used + 8192);
    EXPECT_EQ(heap().deallocate(second), 1);
    EXPECT_EQ(heap().deallocate(second), 1);
    EXPECT_EQ(usage().internal_error_count, 1U) << "freed twice";
  });
}

TEST(BlockHeap, RefusesWhatHasNoRoomAndContinuesInTheNextWindow) {
  in_child([] {
    const TestWindow first = attached();
    EXPECT_EQ(heap().window_wanted(), 0);
    void* const large = heap().allocate(64, test_window_bytes - 4096);
    EXPECT_EQ(large, first.base);
    EXPECT_EQ(heap().allocate(64, 8192), nullptr);
    EXPECT_EQ(heap().allocate(64, 2 * test_window_bytes), nullptr);
    EXPECT_EQ(heap().allocate(64, ~std::size_t{0}), nullptr);
    EXPECT_EQ(usage().refused_count, 1U) << "what is larger than a window does not count";
    EXPECT_EQ(heap().window_wanted(), 1);
    const TestWindow second = make_window();
    const auto described = second.described();
    ASSERT_EQ(heap().add_window(&described), AGNOCAST_HEAPHOOK_OK);
    EXPECT_EQ(heap().window_wanted(), 0);
    void* const next = heap().allocate(64, 8192);
    EXPECT_TRUE(is_within(second, next, 8192, announced[1].load()));
    EXPECT_EQ(heap().frontier(1), announced[1].load());
    EXPECT_EQ(heap().first_window(), 0U);
    heap().deallocate(large);
    EXPECT_EQ(heap().allocate(64, 10 * 4096), first.base) << "the first window is still used";
  });
}

TEST(BlockHeap, LeavesEarlierWindowsForAFreshOne) {
  in_child([] {
    const TestWindow first = attached();
    void* const early = heap().allocate(64, 1 << 20);
    void* const freed = heap().allocate(64, 1 << 20);
    std::memset(early, 1, 1 << 20);
    std::memset(freed, 1, 1 << 20);
    heap().deallocate(freed);
    const TestWindow second = make_window();
    const auto described = second.described(AGNOCAST_HEAPHOOK_WINDOW_FRESH);
    ASSERT_EQ(heap().add_window(&described), AGNOCAST_HEAPHOOK_OK);
    EXPECT_EQ(heap().first_window(), 1U);
    EXPECT_EQ(heap().allocate(64, 1000), second.base);
    heap().deallocate(early);
    EXPECT_TRUE(is_within(second, heap().allocate(64, 1 << 20), 1 << 20, test_window_bytes));
    EXPECT_GE(heap().purge(), 2U << 20) << "its memory goes back to the system";
    EXPECT_EQ(first.allocated(), 0U);
    EXPECT_EQ(usage().internal_error_count, 0U);
  });
}

TEST(BlockHeap, GivesBackWhatWasNotNeeded) {
  in_child([] {
    const TestWindow window = attached();
    constexpr std::size_t size = 4 << 20;
    void* const spike = heap().allocate(64, size);
    void* const kept = heap().allocate(64, 4096);
    std::memset(spike, 1, size);
    std::memset(kept, 2, 4096);
    EXPECT_EQ(heap().idle(), 0U);
    heap().deallocate(spike);
    EXPECT_EQ(heap().idle(), 0U) << "it was needed since the last call";
    EXPECT_EQ(heap().idle(), size);
    void* const again = heap().allocate(64, size);
    EXPECT_EQ(again, spike);
    heap().deallocate(again);
    EXPECT_EQ(heap().idle(), 0U) << "needed once more";
    EXPECT_EQ(heap().idle(), size);
    EXPECT_GE(window.allocated(), size);
    EXPECT_EQ(heap().purge(), size);
    EXPECT_LE(window.allocated(), 2 * page_bytes());
    EXPECT_EQ(heap().idle(), 0U);
    EXPECT_EQ(heap().purge(), 0U) << "nothing is left to return";
    EXPECT_EQ(*static_cast<std::byte*>(kept), std::byte{2});
    auto* const zero = static_cast<std::byte*>(heap().allocate(64, size));
    EXPECT_EQ(zero[size - 1], std::byte{0});
    std::memset(zero, 3, size);
    EXPECT_GE(window.allocated(), size);
  });
}

// A page that is closed and then used in part, beside pages that a reader has touched.
TEST(BlockHeap, KeepsABlockInAPageThatWasReturned) {
  in_child([] {
    const TestWindow window = attached();
    constexpr std::size_t size = 1 << 20;
    void* const spike = heap().allocate(64, size);
    std::memset(spike, 1, size);
    heap().deallocate(spike);
    EXPECT_EQ(heap().purge(), size);
    auto* const block = static_cast<std::byte*>(heap().allocate(64, 100));
    std::memset(block, 7, 100);
    void* const view = ::mmap(nullptr, size, PROT_READ, MAP_SHARED, window.reader.get(), 0);
    ASSERT_NE(view, MAP_FAILED);
    for (std::size_t at = 0; at < size; at += 4096)
      (void)*(static_cast<const volatile char*>(view) + at);
    EXPECT_GT(window.allocated(), 2 * page_bytes());
    EXPECT_GT(heap().idle(), 0U) << "pages that a reader brought back";
    heap().purge();
    EXPECT_LE(window.allocated(), 2 * page_bytes());
    for (int i = 0; i < 100; ++i) ASSERT_EQ(block[i], std::byte{7});
    ::munmap(view, size);
  });
}

TEST(BlockHeap, JoinsNoMemoryOfTwoWindows) {
  in_child([] {
    TestWindow first = make_window(2);
    attach(first);
    TestWindow second = make_window();
    second.base = first.base + test_window_bytes;
    const auto described = second.described();
    ASSERT_EQ(heap().add_window(&described), AGNOCAST_HEAPHOOK_OK);
    void* const low = heap().allocate(64, test_window_bytes);
    void* const high = heap().allocate(64, test_window_bytes);
    EXPECT_EQ(low, first.base);
    EXPECT_EQ(high, second.base);
    heap().deallocate(low);
    heap().deallocate(high);
    EXPECT_EQ(heap().allocate(64, test_window_bytes + 64), nullptr);
    EXPECT_EQ(heap().allocate(64, test_window_bytes), low);
    EXPECT_EQ(heap().allocate(64, test_window_bytes), high);
  });
}

TEST(BlockHeap, AsksForAWindowAfterAPurgeAsBefore) {
  in_child([] {
    const TestWindow window = attached();
    heap().deallocate(heap().allocate(64, 1 << 20));
    heap().purge();
    EXPECT_NE(heap().allocate(64, test_window_bytes / 2), nullptr);
    EXPECT_EQ(heap().window_wanted(), 0);
    EXPECT_EQ(heap().allocate(64, test_window_bytes), nullptr);
    EXPECT_EQ(heap().window_wanted(), 1);
  });
}

TEST(BlockHeap, ServesThreadsWhileOneReturnsMemory) {
  in_child([] {
    const TestWindow window = attached();
    std::atomic<bool> ends{false};
    std::thread returning([&] {
      while (!ends.load()) {
        heap().idle();
        heap().purge();
      }
    });
    std::vector<std::thread> threads;
    for (unsigned t = 1; t <= 3; ++t) {
      threads.emplace_back([t] {
        std::mt19937_64 random(t);
        for (int i = 0; i < 2'000; ++i) {
          const std::size_t bytes = 1 + random() % 20'000;
          auto* const block = static_cast<std::byte*>(heap().allocate(64, bytes));
          if (block == nullptr) continue;
          std::memset(block, static_cast<int>(t), bytes);
          if (block[0] != std::byte(t) || block[bytes - 1] != std::byte(t)) std::abort();
          heap().deallocate(block);
        }
      });
    }
    for (auto& thread : threads) thread.join();
    ends = true;
    returning.join();
    EXPECT_EQ(usage().live_bytes, 0U);
    EXPECT_EQ(usage().internal_error_count, 0U);
    heap().purge();
    EXPECT_LE(window.allocated(), page_bytes());
  });
}

TEST(BlockHeap, HasNothingForAForkedChild) {
  in_child([] {
    const TestWindow window = attached();
    void* const block = heap().allocate(64, 1000);
    std::memset(block, 9, 1000);
    in_child([&] {
      EXPECT_EQ(heap().allocate(64, 1000), nullptr);
      EXPECT_EQ(*static_cast<std::byte*>(block), std::byte{9}) << "a view of its own";
      *static_cast<std::byte*>(block) = std::byte{1};
      EXPECT_EQ(heap().deallocate(block), 1);
      EXPECT_EQ(heap().purge(), 0U);
      const TestWindow other = make_window();
      const auto described = other.described();
      const agnocast_heaphook_options options{AGNOCAST_HEAPHOOK_SCOPE_LOAN, 0,
                                              [](void*, std::uint32_t, std::uint64_t) {}, nullptr};
      EXPECT_EQ(heap().attach(&described, &options), AGNOCAST_HEAPHOOK_FORKED);
      EXPECT_EQ(heap().add_window(&described), AGNOCAST_HEAPHOOK_FORKED);
    });
    EXPECT_EQ(usage().live_bytes, 1024U);
    EXPECT_EQ(*static_cast<std::byte*>(block), std::byte{9});
    EXPECT_EQ(heap().deallocate(block), 1);
  });
}

}  // namespace
}  // namespace agnocast
