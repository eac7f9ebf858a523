// SPDX-License-Identifier: Apache-2.0
//
// Goal: pages go back to the system when purge frees them and never before; locked memory is the
// memory in use; contents survive all of it together. Method: st_blocks of the memfd,
// /proc/self/status, and a soak with patterns in every block.

#include "support.hpp"

#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <mutex>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include <malloc.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

namespace {

using namespace hook_test;

HOOKED_TEST(HookMemory, PurgeReturnsTheMemoryOfFreedMessages) {
  WindowFile file(1024 * MiB);
  attach(file);
  std::vector<char*> messages(200);
  for (int round = 0; round < 2; ++round) {
    {
      Scope scope;
      for (char*& message : messages) {
        message = static_cast<char*>(malloc(MiB));
        ASSERT_TRUE(is_shared(message));
        std::memset(message, 1, MiB);
      }
    }
    EXPECT_GE(file.resident_bytes(), 200 * MiB);
    EXPECT_GE(hook_test::usage().live_bytes, 200 * MiB);
    const std::uint64_t punched = hook_test::usage().punch_count;
    for (char* message : messages) free(message);
    EXPECT_EQ(hook_test::usage().punch_count, punched) << "free gives no page back";
    EXPECT_GE(file.resident_bytes(), 200 * MiB);
    EXPECT_GE(hook().purge(), 200 * MiB);
    EXPECT_GT(hook_test::usage().punch_count, punched);
    EXPECT_LT(file.resident_bytes(), MiB);
  }
  EXPECT_LT(hook_test::usage().used_bytes, 210 * MiB) << "returned addresses are used again";
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

// A reader has a descriptor of the window, and allocates pages by touching purged memory.
HOOKED_TEST(HookMemory, PagesThatAReaderTouchesAreReturnedAgain) {
  WindowFile file(256 * MiB);
  attach(file);
  std::vector<char*> messages(64);
  const auto fill = [&](int value) {
    Scope scope;
    for (char*& message : messages) {
      message = static_cast<char*>(malloc(MiB));
      ASSERT_TRUE(is_shared(message));
      std::memset(message, value, MiB);
    }
  };
  const auto read_all = [&] {
    const std::size_t length = hook_test::usage().frontier_bytes;
    void* const mapping = mmap(nullptr, length, PROT_READ, MAP_SHARED, file.window.read_fd, 0);
    ASSERT_NE(mapping, MAP_FAILED);
    unsigned sum = 0;
    for (std::size_t at = 0; at < length; at += 4096)
      sum += static_cast<const unsigned char*>(mapping)[at];
    opaque(&sum);
    munmap(mapping, length);
  };
  fill(1);
  for (std::size_t i = 8; i < messages.size(); ++i) free(messages[i]);
  hook().purge();
  EXPECT_LT(file.resident_bytes(), 12 * MiB);
  EXPECT_LT(hook().idle(), MiB);
  for (int round = 0; round < 3; ++round) {
    read_all();
    EXPECT_GE(file.resident_bytes(), 64 * MiB);
    EXPECT_GE(hook().idle(), 40 * MiB) << "the memory is idle";
    EXPECT_GE(hook().purge(), 40 * MiB);
    EXPECT_LT(file.resident_bytes(), 9 * MiB);
    EXPECT_LT(hook().idle(), MiB);
  }
  for (std::size_t i = 0; i < 8; ++i) EXPECT_EQ(messages[i][MiB - 1], 1) << "memory in use stays";
  // The memory is used again, and is not taken away while in use.
  for (std::size_t i = 0; i < 8; ++i) free(messages[i]);
  fill(2);
  read_all();
  hook().purge();
  for (const char* message : messages) {
    for (std::size_t at = 0; at < MiB; at += 4096) ASSERT_EQ(message[at], 2);
  }
}

HOOKED_TEST(HookMemory, PurgeLeavesLiveMessagesAlone) {
  WindowFile file(512 * MiB);
  attach(file);
  std::vector<unsigned char*> messages(100);
  {
    Scope scope;
    for (std::size_t i = 0; i < messages.size(); ++i) {
      messages[i] = static_cast<unsigned char*>(malloc(300000));
      std::memset(messages[i], static_cast<int>(i), 300000);
    }
  }
  for (std::size_t i = 0; i < messages.size(); i += 2) free(messages[i]);
  hook().purge();
  for (std::size_t i = 1; i < messages.size(); i += 2) {
    for (std::size_t k = 0; k < 300000; ++k) ASSERT_EQ(messages[i][k], i);
    free(messages[i]);
  }
}

HOOKED_TEST(HookMemory, SmallBlocksAreReturnedToo) {
  WindowFile file(512 * MiB);
  attach(file);
  {
    Scope scope;
    std::vector<std::unique_ptr<char[]>> blocks;
    for (int i = 0; i < 200000; ++i) {
      blocks.emplace_back(new char[200]);
      blocks.back()[0] = 1;
    }
  }
  EXPECT_GE(file.resident_bytes(), 40 * MiB);
  hook().purge();
  EXPECT_LT(file.resident_bytes(), 2 * MiB);
}

HOOKED_TEST(HookMemory, IdleMemoryOfSmallMessagesServesLargeOnes) {
  WindowFile file(1024 * MiB);
  attach(file);
  Scope scope;
  for (std::size_t size : {100 * MiB / 1024, MiB, 3 * MiB, 8 * MiB, 50 * MiB, MiB / 2}) {
    std::vector<char*> messages;
    hook().pause();
    messages.reserve(2000);
    hook().resume();
    for (std::size_t sum = 0; sum + size <= 100 * MiB; sum += size) {
      messages.push_back(static_cast<char*>(malloc(size)));
      ASSERT_TRUE(is_shared(messages.back()));
    }
    for (char* message : messages) free(message);
  }
  EXPECT_LT(hook_test::usage().used_bytes, 140 * MiB) << "never more than 100 MiB were live";
}

HOOKED_TEST(HookMemory, IdleIsTheMemoryUnusedSinceTheLastLook) {
  WindowFile file(1024 * MiB);
  attach(file);
  EXPECT_EQ(hook().idle(), 0u);
  const auto use = [](std::size_t count, std::size_t size) {
    std::vector<char*> messages(count);
    {
      Scope scope;
      for (char*& message : messages) {
        message = static_cast<char*>(malloc(size));
        EXPECT_TRUE(is_shared(message));
      }
    }
    for (char* message : messages) free(message);
  };
  use(100, MiB);
  EXPECT_LT(hook().idle(), MiB) << "all of it was in use since the last look";
  EXPECT_GE(hook().idle(), 100 * MiB);
  use(40, MiB);
  std::uint64_t idle = hook().idle();
  EXPECT_GE(idle, 59 * MiB) << "the memory not touched since the last look";
  EXPECT_LE(idle, 61 * MiB);
  EXPECT_GE(hook().idle(), 100 * MiB);
  {
    Scope scope;
    void* block = malloc(MiB);
    for (std::size_t size : {30 * MiB, 10 * MiB, MiB / 32, 20 * MiB}) {
      block = realloc(block, size);
      ASSERT_TRUE(is_shared(block));
    }
    free(block);
  }
  (void)hook().idle();
  EXPECT_GE(hook().idle(), 100 * MiB)
      << "blocks that grow and shrink are counted by their current size";
  EXPECT_GE(hook().purge(), 100 * MiB);
  EXPECT_LT(hook().idle(), MiB);
  for (const std::size_t size : {std::size_t{200}, std::size_t{20} << 10, std::size_t{60} << 10}) {
    (void)hook().purge();
    (void)hook().idle();
    for (int i = 0; i < 3; ++i) {
      use((20 * MiB) / size, size);
      EXPECT_LT(hook().idle(), 4 * MiB)
          << "blocks of " << size << " were in use since the last look";
    }
    EXPECT_GE(hook().idle(), 15 * MiB) << "idle since then";
  }
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

HOOKED_TEST(HookMemory, AsksForHugePages) {
  if (access("/sys/kernel/mm/transparent_hugepage/shmem_enabled", F_OK) != 0)
    GTEST_SKIP() << "this kernel has no huge pages of shared memory";
  WindowFile file(512 * MiB);
  attach(file);
  char begin[20];
  std::snprintf(begin, sizeof begin, "%lx-",
                static_cast<unsigned long>(reinterpret_cast<std::uintptr_t>(file.window.base)));
  std::ifstream maps("/proc/self/smaps");
  std::string line;
  while (std::getline(maps, line) && line.rfind(begin, 0) != 0) {
  }
  ASSERT_TRUE(maps) << "the window is not mapped";
  while (std::getline(maps, line) && line.rfind("VmFlags:", 0) != 0) {
  }
  EXPECT_NE((line + " ").find(" hg "), std::string::npos) << line;
}

HOOKED_TEST(HookMemory, SteadyStateReusesWarmPages) {
  WindowFile file(1024 * MiB);
  attach(file);
  Scope scope;
  for (int i = 0; i < 1000; ++i) {
    auto* const message = static_cast<char*>(malloc(8 * MiB));
    ASSERT_TRUE(is_shared(message));
    std::memset(message, 1, 4096);
    free(message);
  }
  EXPECT_LT(hook_test::usage().used_bytes, 20 * MiB);
  EXPECT_EQ(hook_test::usage().punch_count, 0u);
}

// --- mlockall -----------------------------------------------------------------------------------

constexpr std::size_t locked_overhead_kib =
    26 * 1024;  // private metadata of the allocator, and one step of the frontier

void use_ten_mib() {
  Scope scope;
  for (int i = 0; i < 10; ++i) {
    auto* const message = static_cast<char*>(malloc(MiB));
    ASSERT_TRUE(is_shared(message));
    std::memset(message, 1, MiB);
  }
}

HOOKED_TEST(HookMemory, MlockallBeforeAttachLocksOnlyUsedMemory) {
  if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0)
    GTEST_SKIP() << "this process may not lock its memory";
  const std::size_t locked = self_status_kib("VmLck");
  WindowFile file(4096 * MiB);
  attach(file);
  use_ten_mib();
  EXPECT_GE(self_status_kib("VmLck"), locked + 10 * 1024);
  EXPECT_LE(self_status_kib("VmLck"), locked + 10 * 1024 + locked_overhead_kib);
  EXPECT_LE(file.resident_bytes(), 14 * MiB);
}

HOOKED_TEST(HookMemory, MlockallAfterAttachLocksOnlyUsedMemory) {
  WindowFile file(4096 * MiB);
  attach(file);
  use_ten_mib();
  if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0)
    GTEST_SKIP() << "this process may not lock its memory";
  EXPECT_LE(file.resident_bytes(), 14 * MiB);
  use_ten_mib();
  EXPECT_LE(file.resident_bytes(), 26 * MiB);
  EXPECT_LE(self_status_kib("VmLck"), 200u * 1024) << "far below the window";
}

HOOKED_TEST(HookMemory, PurgeWorksOnLockedMemory) {
  WindowFile file(1024 * MiB);
  attach(file);
  if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0)
    GTEST_SKIP() << "this process may not lock its memory";
  char* kept = nullptr;
  {
    Scope scope;
    kept = static_cast<char*>(malloc(MiB));
    std::memset(kept, 0x33, MiB);
    void* const idle = opaque(malloc(50 * MiB));
    EXPECT_GE(file.resident_bytes(), 51 * MiB);
    free(idle);
  }
  EXPECT_GE(hook().purge(), 50 * MiB);
  EXPECT_LE(file.resident_bytes(), 15 * MiB)
      << "the kept message and the memory between use and frontier";
  for (std::size_t i = 0; i < MiB; ++i) ASSERT_EQ(kept[i], 0x33);
  Scope scope;
  auto* const again = static_cast<char*>(calloc(1, 20 * MiB));
  ASSERT_TRUE(is_shared(again));
  for (std::size_t i = 0; i < 20 * MiB; ++i) ASSERT_EQ(again[i], 0);
}

// Limits apply only without CAP_IPC_LOCK.
bool become_ordinary_with_lock_limit(std::size_t bytes) {
  const rlimit limit{bytes, bytes};
  if (setrlimit(RLIMIT_MEMLOCK, &limit) != 0) return false;
  return geteuid() != 0 || setresuid(65534, 65534, 65534) == 0;
}

HOOKED_TEST(HookMemory, ATooSmallLockLimitIsNamedAndLeavesNothingBehind) {
  WindowFile file(1024 * MiB);
  const std::size_t addresses = self_status_kib("VmSize");
  if (!become_ordinary_with_lock_limit(8 * MiB) || mlockall(MCL_FUTURE) != 0) {
    GTEST_SKIP() << "cannot set RLIMIT_MEMLOCK and mlockall(MCL_FUTURE) here";
  }
  const agnocast_heaphook_options options = options_for(AGNOCAST_HEAPHOOK_SCOPE_LOAN);
  EXPECT_EQ(hook().attach(&file.window, &options), AGNOCAST_HEAPHOOK_LOCK_LIMIT);
  EXPECT_EQ(errno, EAGAIN);
  EXPECT_LE(self_status_kib("VmSize"), addresses + 1024);
  Scope scope;
  EXPECT_FALSE(is_shared(opaque(malloc(100))));
  munlockall();
  EXPECT_EQ(hook().attach(&file.window, &options), AGNOCAST_HEAPHOOK_OK)
      << "attach may be tried again";
  EXPECT_TRUE(is_shared(opaque(malloc(100))));
}

HOOKED_TEST(HookMemory, AttachMayBeTriedAgainAfterTooFewAddresses) {
  WindowFile file(64 * MiB);
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_AS, &before), 0);
  const agnocast_heaphook_options options = options_for(AGNOCAST_HEAPHOOK_SCOPE_LOAN);
  for (const std::size_t room : {4u, 12u, 16u, 20u}) {
    const rlimit tight{self_status_kib("VmSize") * 1024 + room * MiB, before.rlim_max};
    ASSERT_EQ(setrlimit(RLIMIT_AS, &tight), 0);
    EXPECT_EQ(hook().attach(&file.window, &options), AGNOCAST_HEAPHOOK_OS)
        << room << " MiB of room";
    EXPECT_EQ(errno, ENOMEM);
    ASSERT_EQ(setrlimit(RLIMIT_AS, &before), 0);
  }
  EXPECT_EQ(hook().attach(&file.window, &options), AGNOCAST_HEAPHOOK_OK)
      << "attach may be tried again";
  Scope scope;
  EXPECT_TRUE(is_shared(opaque(malloc(100))));
}

HOOKED_TEST(HookMemory, GrowthIntoTheLockLimitFallsBackToLibc) {
  WindowFile file(1024 * MiB);
  attach(file);
  if (!become_ordinary_with_lock_limit(8 * MiB) || mlockall(MCL_FUTURE) != 0) {
    GTEST_SKIP() << "cannot set RLIMIT_MEMLOCK and mlockall(MCL_FUTURE) here";
  }
  Scope scope;
  std::size_t shared = 0;
  for (int i = 0; i < 100; ++i) {
    void* const block = malloc(MiB);
    shared += is_shared(block) ? 1u : 0u;
  }
  EXPECT_GE(shared, 4u);
  EXPECT_LT(shared, 12u);
  EXPECT_GE(hook_test::usage().mapping_refused_count, 1u);
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

// --- soak ---------------------------------------------------------------------------------------

struct Slot {
  std::mutex mutex;
  unsigned char* block = nullptr;
  std::size_t size = 0;
  unsigned char pattern = 0;
};

bool intact(const Slot& slot) {
  for (std::size_t i = 0; i<slot.size; i += slot.size> 4096 ? 509 : 1) {
    if (slot.block[i] != slot.pattern) return false;
  }
  return slot.size == 0 || slot.block[slot.size - 1] == slot.pattern;
}

// Long because each random operation has its branch.
HOOKED_TEST(HookMemory, SoakOfRandomOperationsByFourThreads) {
  static Slot slots[512];
  WindowFile file(512 * MiB);
  WindowFile second(64 * MiB, hook_test::window_address + (std::uintptr_t{1} << 30));
  attach(file);
  std::atomic<int> wrong{0};
  std::atomic<bool> stop{false};
  std::atomic<std::uint64_t> operations{0};
  std::vector<std::thread> threads;
  for (unsigned t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      std::mt19937_64 random(t + 1);
      int depth = 0;
      while (!stop) {
        const std::uint64_t r = random();
        if (r % 64 == 0 && depth < 5) {
          hook().enter();
          ++depth;
        } else if (r % 64 == 1 && depth > 0) {
          hook().leave();
          --depth;
        }
        Slot& slot = slots[(r >> 8) % std::size(slots)];
        const std::size_t size = (r >> 20) % (std::uint64_t{1} << ((r >> 50) % 21));
        const std::lock_guard lock(slot.mutex);
        if (!intact(slot)) ++wrong;
        void* block = slot.block;
        switch ((r >> 56) % 5) {
          case 0:
            free(block);
            block = malloc(size);
            break;
          case 1: {
            void* const moved = realloc(block, size + 1);
            block = moved;
            if (slot.block != nullptr) {
              const std::size_t kept = slot.size < size + 1 ? slot.size : size + 1;
              const auto* const bytes = static_cast<unsigned char*>(block);
              for (std::size_t i = 0; i < kept; i += 61) wrong += bytes[i] != slot.pattern;
            }
            break;
          }
          case 2:
            free(block);
            block = calloc(size, 1);
            for (std::size_t i = 0; i < size; i += 127)
              wrong += static_cast<unsigned char*>(block)[i] != 0;
            break;
          case 3:
            free(block);
            block = aligned_alloc(std::size_t{16} << (r % 9), size);
            break;
          default:
            operator delete(block);
            block = operator new(size);
        }
        slot.block = static_cast<unsigned char*>(block);
        slot.size = size;
        slot.pattern = static_cast<unsigned char>(r >> 32);
        if (malloc_usable_size(block) < size) ++wrong;
        std::memset(block, slot.pattern, size);
        operations.fetch_add(1, std::memory_order_relaxed);
      }
    });
  }
  for (int i = 0; i < 30; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    hook().purge();
    if (i == 15) {
      EXPECT_EQ(hook().add_window(&second.window), AGNOCAST_HEAPHOOK_OK);
    }
    (void)hook_test::usage();
  }
  stop = true;
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(wrong.load(), 0);
  EXPECT_GT(operations.load(), 1000u);
  for (Slot& slot : slots) {
    EXPECT_TRUE(intact(slot));
    free(slot.block);
  }
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
  EXPECT_EQ(hook_test::usage().live_bytes, 0u);
  hook().purge();
  EXPECT_LT(file.resident_bytes(), 2 * MiB);
}

}  // namespace
