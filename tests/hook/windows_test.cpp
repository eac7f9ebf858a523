// SPDX-License-Identifier: Apache-2.0
//
// Goal: windows open by frontier, in the promised order; a full window falls back to libc; more
// windows; refusals of attach.
// Method: memfds of this test; the callback's record compared with every address that malloc
// returns.

#include "support.hpp"

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <string>
#include <thread>
#include <vector>

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

namespace {

using namespace hook_test;

// Returns whether the whole block lies below the frontier announced so far.
bool announced_covers(const void* block, std::size_t size) {
  const std::uintptr_t offset = reinterpret_cast<std::uintptr_t>(block) - window_address;
  return offset + size <= announced.frontier[0].load(std::memory_order_acquire);
}

// Returns how many bytes of addresses in [window, window + length) are mapped.
std::size_t mapped_bytes(std::uintptr_t base, std::size_t length) {
  std::ifstream maps("/proc/self/maps");
  std::string line;
  std::size_t bytes = 0;
  while (std::getline(maps, line)) {
    std::size_t dash = 0;
    const std::uintptr_t first = std::stoul(line, &dash, 16);
    const std::uintptr_t last = std::stoul(line.substr(dash + 1), nullptr, 16);
    if (first >= base && last <= base + length && line.find(" rw-s ") != std::string::npos)
      bytes += last - first;
  }
  return bytes;
}

HOOKED_TEST(HookWindows, TheFrontierIsAnnouncedBeforeAnAddressBeyondItIsReturned) {
  WindowFile file(1024 * MiB);
  attach(file);
  EXPECT_EQ(announced.calls.load(), 1);
  const std::size_t page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  std::uint64_t last_frontier = hook().frontier(0);
  EXPECT_EQ(announced.frontier[0].load(), last_frontier);
  Scope scope;
  for (std::size_t size : {64ul, 3000ul, 40000ul, MiB, 7 * MiB}) {
    for (int i = 0; i < 40; ++i) {
      void* const block = opaque(malloc(size));
      ASSERT_TRUE(announced_covers(block, size));
      std::memset(block, 1, size);
      const std::uint64_t frontier = hook().frontier(0);
      ASSERT_GE(frontier, last_frontier) << "a frontier never shrinks";
      ASSERT_EQ(frontier % page, 0u);
      last_frontier = frontier;
    }
  }
  EXPECT_GT(announced.calls.load(), 5);
  EXPECT_EQ(announced.frontier[0].load(), hook().frontier(0));
  hook().pause();
  EXPECT_EQ(mapped_bytes(window_address, file.window.length), hook().frontier(0))
      << "exactly the announced memory is mapped";
  hook().resume();
}

HOOKED_TEST(HookWindows, ManyThreadsNeverSeeAnAddressBeyondTheAnnouncedFrontier) {
  WindowFile file(2048 * MiB);
  attach(file);
  std::atomic<int> wrong{0};
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      Scope scope;
      for (std::size_t i = 1; i < 400; ++i) {
        const std::size_t size = (i * 7919 * static_cast<std::size_t>(t + 1)) % (1024 * 1024) + 1;
        char* const block = static_cast<char*>(malloc(size));
        if (!is_shared(block) || !announced_covers(block, size)) ++wrong;
        block[size - 1] = 1;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(wrong.load(), 0);
}

HOOKED_TEST(HookWindows, AReservedRangeIsUsedInPlace) {
  WindowFile file(256 * MiB);
  void* const reserved =
      mmap(file.window.base, file.window.length, PROT_NONE,
           MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE | MAP_FIXED_NOREPLACE, -1, 0);
  ASSERT_EQ(reserved, file.window.base);
  const agnocast_heaphook_options options = options_for(AGNOCAST_HEAPHOOK_SCOPE_LOAN);
  EXPECT_EQ(hook().attach(&file.window, &options), AGNOCAST_HEAPHOOK_OCCUPIED)
      << "occupied unless the caller reserved it";
  file.window.flags = AGNOCAST_HEAPHOOK_WINDOW_RESERVED;
  attach(file);
  Scope scope;
  char* const block = static_cast<char*>(malloc(100 * MiB));
  ASSERT_TRUE(is_shared(block));
  std::memset(block, 1, 100 * MiB);
  hook().pause();
  EXPECT_EQ(mapped_bytes(window_address, file.window.length), hook().frontier(0));
  hook().resume();
  free(block);
}

HOOKED_TEST(HookWindows, AnExhaustedWindowFallsBackToLibc) {
  WindowFile file(8 * MiB);
  attach(file);
  Scope scope;
  std::vector<void*> blocks;
  hook().pause();
  blocks.reserve(1000);
  hook().resume();
  std::uint64_t shared = 0;
  for (int i = 0; i < 100; ++i) {
    void* const block = opaque(malloc(200000));
    ASSERT_NE(block, nullptr);
    std::memset(block, 3, 200000);
    shared += is_shared(block) ? 1u : 0u;
    blocks.push_back(block);
  }
  EXPECT_GE(shared, 20u) << "payload fills most of 8 MiB";
  EXPECT_LE(shared, 41u);
  EXPECT_FALSE(is_shared(blocks.back()));
  const agnocast_heaphook_usage full = hook_test::usage();
  EXPECT_EQ(full.refused_count, 100 - shared);
  EXPECT_EQ(hook().spilled(), 100 - shared) << "this thread's spilled blocks";
  std::thread([] { EXPECT_EQ(hook().spilled(), 0u) << "another thread's spilled blocks"; }).join();
  EXPECT_EQ(full.refused_bytes_max, 200000u);
  EXPECT_EQ(full.next_window_wanted, 1u);
  EXPECT_LE(full.used_bytes, full.frontier_bytes);
  EXPECT_LE(full.frontier_bytes, full.length_bytes);
  for (void* block : blocks) free(block);
  void* const again = opaque(malloc(200000));
  EXPECT_TRUE(is_shared(again)) << "freed memory is used again";
  free(again);
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

HOOKED_TEST(HookWindows, ARequestLargerThanAWindowDoesNotMakeItFull) {
  WindowFile file(8 * MiB);
  attach(file);
  Scope scope;
  void* const block = opaque(malloc(9 * MiB));
  EXPECT_FALSE(is_shared(block));
  EXPECT_EQ(hook_test::usage().refused_count, 0u);
  EXPECT_EQ(hook_test::usage().refused_bytes_max, 9 * MiB) << "the next window may be larger";
  free(block);
}

HOOKED_TEST(HookWindows, SmallBlocksExhaustAWindowToo) {
  WindowFile file(4 * MiB);
  attach(file);
  Scope scope;
  std::size_t shared = 0;
  void* last = nullptr;
  for (int i = 0; i < 200000; ++i) {
    void* const block = opaque(malloc(64));
    ASSERT_NE(block, nullptr);
    shared += is_shared(block) ? 1u : 0u;
    last = block;
  }
  EXPECT_FALSE(is_shared(last));
  EXPECT_GT(shared * 64, 3 * MiB);
}

HOOKED_TEST(HookWindows, ThreeQuartersUsedAsksForTheNextWindow) {
  WindowFile file(64 * MiB);
  attach(file);
  Scope scope;
  EXPECT_EQ(hook_test::usage().next_window_wanted, 0u);
  std::size_t taken = 0;
  while (hook_test::usage().used_bytes < 48 * MiB) {
    ASSERT_EQ(hook_test::usage().next_window_wanted, 0u) << taken;
    ASSERT_TRUE(is_shared(opaque(malloc(MiB))));
    taken += MiB;
    ASSERT_LE(taken, 64 * MiB);
  }
  EXPECT_EQ(hook_test::usage().next_window_wanted, 1u);
  EXPECT_GE(taken, 40 * MiB) << "used memory is nearly all payload";

  WindowFile second(64 * MiB, window_address + (std::uintptr_t{1} << 30));
  ASSERT_EQ(hook().add_window(&second.window), AGNOCAST_HEAPHOOK_OK);
  EXPECT_EQ(hook_test::usage().next_window_wanted, 0u);
  EXPECT_EQ(hook_test::usage().window_count, 2u);
  EXPECT_EQ(announced.frontier[1].load(), hook().frontier(1));
  bool in_second = false;
  for (int i = 0; i < 60; ++i) {
    auto* const block = static_cast<char*>(malloc(MiB));
    ASSERT_TRUE(is_shared(block)) << i;
    std::memset(block, 1, MiB);
    in_second |= block >= static_cast<char*>(second.window.base);
  }
  EXPECT_TRUE(in_second);
}

HOOKED_TEST(HookWindows, AFreshWindowReplacesThoseBeforeIt) {
  WindowFile first(64 * MiB);
  WindowFile second(64 * MiB, window_address + (std::uintptr_t{1} << 30));
  attach(first);
  const auto in = [](const WindowFile& file, const void* block) {
    return reinterpret_cast<std::uintptr_t>(block) -
               reinterpret_cast<std::uintptr_t>(file.window.base) <
           file.window.length;
  };
  void* before[64];
  for (std::size_t i = 0; i < 64; ++i) {
    Scope scope;
    before[i] = opaque(malloc(64u << i % 4));
    ASSERT_TRUE(in(first, before[i]));
  }
  // Half of them go into the cache of this thread, which would serve the next block of their size.
  for (std::size_t i = 0; i < 32; ++i) free(before[i]);
  EXPECT_EQ(hook().first_window(), 0u);
  second.window.flags = AGNOCAST_HEAPHOOK_WINDOW_FRESH;
  ASSERT_EQ(hook().add_window(&second.window), AGNOCAST_HEAPHOOK_OK);
  EXPECT_EQ(hook().first_window(), 1u);
  for (std::size_t i = 32; i < 48; ++i) free(before[i]);

  const auto allocates_in_second = [&] {
    Scope scope;
    std::size_t elsewhere = 0;
    void* blocks[200];
    for (std::size_t i = 0; i < 200; ++i) {
      blocks[i] = opaque(malloc(64u << i % 4));
      elsewhere += in(second, blocks[i]) ? 0u : 1u;
    }
    for (void* block : blocks) free(block);
    return elsewhere == 0;
  };
  EXPECT_TRUE(allocates_in_second()) << "a thread with blocks of the first window in its cache";
  for (std::size_t i = 48; i < 64; ++i) free(before[i]);
  EXPECT_TRUE(allocates_in_second()) << "a thread that has freed blocks of the first window since";
  bool elsewhere = false;
  std::thread([&] { elsewhere = !allocates_in_second(); }).join();
  EXPECT_FALSE(elsewhere) << "a new thread";

  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
  EXPECT_GT(hook().purge(), 0u)
      << "idle memory of the first window goes back to the kernel as well";
}

HOOKED_TEST(HookWindows, ABlockOfAReplacedWindowMovesWhenItGrows) {
  WindowFile first(64 * MiB);
  WindowFile second(64 * MiB, window_address + (std::uintptr_t{1} << 30));
  attach(first);
  char* block = nullptr;
  {
    Scope scope;
    block = static_cast<char*>(opaque(malloc(MiB)));
  }
  std::memset(block, 7, MiB);
  second.window.flags = AGNOCAST_HEAPHOOK_WINDOW_FRESH;
  ASSERT_EQ(hook().add_window(&second.window), AGNOCAST_HEAPHOOK_OK);
  EXPECT_EQ(hook_test::usage().live_bytes, MiB);
  Scope scope;
  EXPECT_EQ(opaque(realloc(block, MiB / 2 + 1)), block) << "a shrinking block may stay";
  auto* const moved = static_cast<char*>(opaque(realloc(block, 2 * MiB)));
  EXPECT_GE(reinterpret_cast<std::uintptr_t>(moved),
            reinterpret_cast<std::uintptr_t>(second.window.base));
  EXPECT_EQ(moved[0], 7);
  EXPECT_EQ(moved[MiB / 2], 7);
  free(moved);
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

HOOKED_TEST(HookWindows, EightWindowsAreTheMaximum) {
  std::vector<std::unique_ptr<WindowFile>> files;
  for (std::uintptr_t i = 0; i < 9; ++i)
    files.push_back(std::make_unique<WindowFile>(4 * MiB, window_address + i * 4 * MiB));
  attach(*files[0]);
  for (std::size_t i = 1; i < 8; ++i)
    ASSERT_EQ(hook().add_window(&files[i]->window), AGNOCAST_HEAPHOOK_OK) << i;
  EXPECT_EQ(hook().add_window(&files[8]->window), AGNOCAST_HEAPHOOK_FULL);
  // Neighbouring windows are different files: a block must never span two of them.
  Scope scope;
  int shared = 0;
  void* blocks[40];
  for (void*& place : blocks) {
    auto* const block = static_cast<char*>(malloc(MiB + 4096));
    place = block;
    std::memset(block, 1, MiB + 4096);
    if (!is_shared(block)) continue;
    ++shared;
    const std::uintptr_t offset = reinterpret_cast<std::uintptr_t>(block) - window_address;
    EXPECT_EQ(offset / (4 * MiB), (offset + MiB + 4095) / (4 * MiB));
  }
  EXPECT_GE(shared, 16);
  EXPECT_EQ(hook_test::usage().next_window_wanted, 0u) << "there is no ninth to ask for";
  for (void* block : blocks) free(block);
  void* const wide = opaque(malloc(6 * MiB));
  EXPECT_FALSE(is_shared(wide)) << "idle memory of two windows does not add up to one block";
  free(wide);
}

HOOKED_TEST(HookWindows, AttachRefusesUnusableWindows) {
  const agnocast_heaphook_options good = options_for(AGNOCAST_HEAPHOOK_SCOPE_LOAN);
  WindowFile file(16 * MiB);
  const auto attach_with = [&](auto change) {
    agnocast_heaphook_window window = file.window;
    agnocast_heaphook_options options = good;
    change(window, options);
    return hook().attach(&window, &options);
  };
  using Window = agnocast_heaphook_window;
  using Options = agnocast_heaphook_options;
  EXPECT_EQ(hook().attach(nullptr, &good), AGNOCAST_HEAPHOOK_INVALID);
  EXPECT_EQ(hook().attach(&file.window, nullptr), AGNOCAST_HEAPHOOK_INVALID);
  EXPECT_EQ(attach_with([](Window&, Options& o) { o.grown = nullptr; }), AGNOCAST_HEAPHOOK_INVALID);
  EXPECT_EQ(attach_with([](Window&, Options& o) { o.scope = 7; }), AGNOCAST_HEAPHOOK_INVALID);
  EXPECT_EQ(attach_with([](Window& w, Options&) { w.base = nullptr; }), AGNOCAST_HEAPHOOK_INVALID);
  EXPECT_EQ(attach_with([](Window& w, Options&) { w.base = static_cast<char*>(w.base) + 4096; }),
            AGNOCAST_HEAPHOOK_INVALID);
  EXPECT_EQ(attach_with([](Window& w, Options&) { w.length = 0; }), AGNOCAST_HEAPHOOK_INVALID);
  EXPECT_EQ(attach_with([](Window& w, Options&) { w.length += 4096; }), AGNOCAST_HEAPHOOK_INVALID);
  EXPECT_EQ(attach_with([](Window& w, Options&) { w.length *= 2; }), AGNOCAST_HEAPHOOK_INVALID)
      << "longer than the file";
  EXPECT_EQ(attach_with([](Window& w, Options&) { w.flags = 4; }), AGNOCAST_HEAPHOOK_INVALID);
  EXPECT_EQ(attach_with([](Window& w, Options&) { w.flags = AGNOCAST_HEAPHOOK_WINDOW_FRESH; }),
            AGNOCAST_HEAPHOOK_INVALID)
      << "there is none before the first";
  EXPECT_EQ(attach_with([](Window& w, Options&) { w.read_fd = w.write_fd; }),
            AGNOCAST_HEAPHOOK_INVALID)
      << "not read-only";
  EXPECT_EQ(attach_with([](Window& w, Options&) { w.write_fd = w.read_fd; }),
            AGNOCAST_HEAPHOOK_INVALID)
      << "not writable";
  EXPECT_EQ(attach_with([](Window& w, Options&) { w.write_fd = -1; }), AGNOCAST_HEAPHOOK_OS);
  WindowFile other(16 * MiB);
  EXPECT_EQ(attach_with([&](Window& w, Options&) { w.read_fd = other.window.read_fd; }),
            AGNOCAST_HEAPHOOK_INVALID);
  EXPECT_EQ(hook().add_window(&file.window), AGNOCAST_HEAPHOOK_STATE) << "attach comes first";

  void* const in_the_way = mmap(file.window.base, 4096, PROT_READ,
                                MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED_NOREPLACE, -1, 0);
  ASSERT_NE(in_the_way, MAP_FAILED);
  EXPECT_EQ(hook().attach(&file.window, &good), AGNOCAST_HEAPHOOK_OCCUPIED);
  munmap(in_the_way, 4096);
  EXPECT_EQ(mapped_bytes(window_address, file.window.length), 0u);
  EXPECT_EQ(hook_test::usage().window_count, 0u);

  EXPECT_EQ(hook().attach(&file.window, &good), AGNOCAST_HEAPHOOK_OK)
      << "refusals leave nothing behind";
  EXPECT_EQ(hook().attach(&other.window, &good), AGNOCAST_HEAPHOOK_STATE);
  EXPECT_EQ(hook().add_window(&other.window), AGNOCAST_HEAPHOOK_INVALID) << "overlaps the first";
}

HOOKED_TEST(HookWindows, GrowthSurvivesAProgramThatClosesAllDescriptors) {
  WindowFile file(256 * MiB);
  attach(file);
  for (int fd = 3; fd < 100; ++fd) close(fd);
  for (int i = 0; i < 20; ++i) open("/dev/zero", O_RDWR);  // the numbers now name other files
  Scope scope;
  auto* const block = static_cast<char*>(malloc(50 * MiB));
  ASSERT_NE(block, nullptr);
  EXPECT_FALSE(is_shared(block)) << "the window cannot grow any more";
  std::memset(block, 1, 50 * MiB);
  EXPECT_GE(hook_test::usage().mapping_refused_count, 1u);
  void* const small = opaque(malloc(100));
  EXPECT_TRUE(is_shared(small)) << "mapped memory stays usable";
  std::memset(small, 1, 100);
}

HOOKED_TEST(HookWindows, AMappingInsideTheWindowStopsOnlyItsGrowth) {
  WindowFile file(256 * MiB);
  attach(file);
  void* const intruder =
      mmap(static_cast<char*>(file.window.base) + 16 * MiB, 4096, PROT_READ | PROT_WRITE,
           MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED_NOREPLACE, -1, 0);
  ASSERT_NE(intruder, MAP_FAILED);
  std::memset(intruder, 0x55, 4096);
  Scope scope;
  for (int i = 0; i < 40; ++i) std::memset(opaque(malloc(MiB)), 1, MiB);
  for (int i = 0; i < 4096; ++i) ASSERT_EQ(static_cast<char*>(intruder)[i], 0x55);
  EXPECT_GE(hook_test::usage().mapping_refused_count, 1u);
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

}  // namespace
