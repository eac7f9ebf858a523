// SPDX-License-Identifier: Apache-2.0
//
// Goal: the hook works at every moment of a process and of a thread: before main, as a thread's
// first call, while libraries are loaded and unloaded, at thread exit, after exit began. Method:
// bodies that end in exit handlers report through the exit status.

#include "support.hpp"

#include <algorithm>
#include <csetjmp>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <iterator>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <dlfcn.h>
#include <malloc.h>
#include <pthread.h>
#include <unistd.h>

namespace {

using namespace hook_test;

// --- before main --------------------------------------------------------------------------------

int early_thread_blocks = 0;

void* early_thread(void*) {
  for (int i = 0; i < 100; ++i) {
    std::unique_ptr<char[]> block(new char[static_cast<std::size_t>(i) * 100 + 1]);
    void* const other = realloc(malloc(100), 10000);
    if (opaque(block.get()) != nullptr && other != nullptr) ++early_thread_blocks;
    free(other);
  }
  return nullptr;
}

void* made_before_main = nullptr;

[[gnu::constructor(101)]] void before_main() {
  pthread_t thread;
  if (pthread_create(&thread, nullptr, early_thread, nullptr) == 0) pthread_join(thread, nullptr);
  made_before_main = malloc(1000);
  std::memset(made_before_main, 8, 1000);
}

HOOKED_TEST(HookLifetime, ThreadsBeforeMainAllocate) {
  EXPECT_EQ(early_thread_blocks, 100);
  WindowFile file(64 * MiB);
  attach(file);
  Scope scope;
  auto* const block = static_cast<char*>(realloc(made_before_main, 5000));
  EXPECT_TRUE(is_shared(block));
  EXPECT_EQ(block[999], 8);
  free(block);
}

// --- the first call of a thread -----------------------------------------------------------------

// Long because it is the table of entry points.
HOOKED_TEST(HookLifetime, EveryEntryPointWorksAsTheFirstCallOfAThread) {
  WindowFile file(512 * MiB);
  attach(file);
  const std::function<void*(void*)> acts[] = {
      [](void*) { return malloc(100); },
      [](void*) { return calloc(10, 10); },
      [](void*) { return realloc(nullptr, 100); },
      [](void* block) { return realloc(block, 5000); },
      [](void* block) { return reallocarray(block, 50, 100); },
      [](void* block) { return realloc(block, 0); },
      [](void* block) {
        free(block);
        return block;
      },
      [](void* block) {
        operator delete(block);
        return block;
      },
      [](void* block) { return malloc_usable_size(block) >= 1000 ? block : nullptr; },
      [](void*) {
        void* made = nullptr;
        return posix_memalign(&made, 64, 100) == 0 ? made : nullptr;
      },
      [](void*) { return aligned_alloc(64, 128); },
      [](void*) { return memalign(64, 100); },
      [](void*) { return valloc(100); },
      [](void*) { return pvalloc(100); },
      [](void*) { return operator new(100); },
      [](void*) { return operator new[](100, std::align_val_t{64}); },
      [](void*) { return hook().purge() == 1 ? nullptr : nullptr; },
      [](void*) { return hook_test::usage().window_count == 1 ? nullptr : nullptr; },
  };
  struct Start {
    const std::function<void*(void*)>* act;
    void* block;
    void* result;
    bool in_scope;
  };
  for (bool in_scope : {false, true}) {
    for (std::size_t i = 0; i < std::size(acts); ++i) {
      for (bool shared_block : {false, true}) {
        if (shared_block) hook().enter();
        Start start{&acts[i], malloc(1000), nullptr, in_scope};
        if (shared_block) hook().leave();
        pthread_t thread;
        ASSERT_EQ(pthread_create(
                      &thread, nullptr,
                      [](void* argument) -> void* {
                        auto& it = *static_cast<Start*>(argument);
                        if (it.in_scope) hook().enter();
                        it.result = (*it.act)(it.block);
                        return nullptr;
                      },
                      &start),
                  0);
        pthread_join(thread, nullptr);
        const bool makes = i < 5 || (i >= 9 && i < 16);
        if (makes) {
          ASSERT_NE(start.result, nullptr) << i;
          const bool keeps = i == 3 || i == 4;
          EXPECT_EQ(is_shared(start.result), in_scope || (keeps && shared_block)) << i;
          if (keeps) start.block = nullptr;
          free(start.result);
        }
        const bool ate_it = i >= 5 && i < 8;
        if (!ate_it) free(start.block);
      }
    }
  }
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

// --- thread exit --------------------------------------------------------------------------------

HOOKED_TEST(HookLifetime, AnEndingThreadGivesItsCacheBack) {
  WindowFile file(512 * MiB);
  attach(file);
  for (int round = 0; round < 50; ++round) {
    std::thread([] {
      Scope scope;
      std::vector<std::unique_ptr<char[]>> blocks;
      for (std::size_t i = 0; i < 2000; ++i) blocks.emplace_back(new char[i % 5000 + 1]);
    }).join();
  }
  const agnocast_heaphook_usage usage = hook_test::usage();
  EXPECT_EQ(usage.live_bytes, 0u);
  EXPECT_LT(usage.used_bytes, 40 * MiB)
      << "fifty threads one after the other need the memory of one";
  hook().purge();
  EXPECT_LT(file.resident_bytes(), MiB);
}

pthread_key_t late_key;

HOOKED_TEST(HookLifetime, DestructorsOfThreadDataMayFreeAndAllocate) {
  WindowFile file(64 * MiB);
  attach(file);
  // Runs at thread exit, after and between the allocator's own clean-up (glibc repeats up to four
  // times).
  static int runs = 0;
  ASSERT_EQ(pthread_key_create(&late_key,
                               [](void* block) {
                                 free(block);
                                 Scope scope;
                                 void* const again = malloc(3000);
                                 if (++runs % 3 != 0) {
                                   pthread_setspecific(late_key, again);
                                 } else {
                                   free(again);
                                 }
                               }),
            0);
  for (int i = 0; i < 10; ++i) {
    std::thread([] {
      Scope scope;
      pthread_setspecific(late_key, malloc(100));
    }).join();
  }
  EXPECT_EQ(runs, 30);
  EXPECT_EQ(hook_test::usage().live_bytes, 0u);
}

HOOKED_TEST(HookLifetime, ManyThreadKeysOfTheProgramDoNoHarm) {
  // From the 33rd key on glibc allocates when a thread first sets it, also for the allocator's own
  // key.
  for (int i = 0; i < 100; ++i) {
    pthread_key_t key;
    ASSERT_EQ(pthread_key_create(&key, nullptr), 0);
  }
  WindowFile file(64 * MiB);
  attach(file, AGNOCAST_HEAPHOOK_SCOPE_ALL);
  bool shared = false;
  std::uint64_t live = 0;
  hook().pause();  // the thread object itself stays out of the window
  std::thread thread([&] {
    void* const block = opaque(malloc(100));
    shared = is_shared(block);
    live = hook_test::usage().live_bytes;
    free(block);
  });
  thread.join();
  hook().resume();
  EXPECT_TRUE(shared);
  EXPECT_LE(live, 112u) << "libc's own allocations inside the allocator are not shared";
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

// --- libraries that are loaded and unloaded -----------------------------------------------------

HOOKED_TEST(HookLifetime, LibrariesWithThreadLocalDataComeAndGo) {
  WindowFile file(256 * MiB);
  attach(file, AGNOCAST_HEAPHOOK_SCOPE_ALL);
  const std::string path = std::string(AGNOCAST_TEST_PROGRAMS) + "/libhook_test_module.so";
  std::atomic<int> wrong{0};
  for (int round = 0; round < 100; ++round) {
    void* const module = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
    ASSERT_NE(module, nullptr) << dlerror();
    const auto work = reinterpret_cast<std::size_t (*)(std::size_t)>(dlsym(module, "module_work"));
    ASSERT_NE(work, nullptr);
    std::vector<std::thread> threads;
    for (std::size_t t = 0; t < 3; ++t) {
      threads.emplace_back([&, t] {
        for (std::size_t i = 0; i < 20; ++i) {
          if (work(i * 1000 + t) != 51) ++wrong;
        }
      });
    }
    for (std::thread& thread : threads) thread.join();
    if (work(10) != 51) ++wrong;
    dlclose(module);
  }
  EXPECT_EQ(wrong.load(), 0);
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

HOOKED_TEST(HookLifetime, LoadingWhileThreadsAllocateNeverDeadlocks) {
  WindowFile file(256 * MiB);
  attach(file);
  const std::string path = std::string(AGNOCAST_TEST_PROGRAMS) + "/libhook_test_module.so";
  std::atomic<bool> stop{false};
  std::vector<std::thread> threads;
  for (int t = 0; t < 2; ++t) {
    threads.emplace_back([&] {
      while (!stop) {
        std::thread([] {  // new threads use the loader's TLS bookkeeping
          Scope scope;
          for (std::size_t i = 1; i < 100; ++i) free(opaque(malloc(i * 50)));
        })
            .join();
      }
    });
  }
  for (int i = 0; i < 200; ++i) {
    void* const module = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
    ASSERT_NE(module, nullptr);
    dlclose(module);
  }
  stop = true;
  for (std::thread& thread : threads) thread.join();
}

// A block in the window, preceded by zeroed memory of the caller's.
struct BehindZeros {
  static constexpr std::size_t bytes = 1024;
  char* blocks[8];
  char* block = nullptr;

  BehindZeros() {
    hook().enter();
    for (char*& each : blocks) each = static_cast<char*>(malloc(bytes));
    hook().leave();
    for (char* const each : blocks) {
      if (std::find(std::begin(blocks), std::end(blocks), each - bytes) != std::end(blocks))
        block = each;
    }
    if (block != nullptr) memset(block - bytes, 0, bytes);
  }
  ~BehindZeros() {
    for (char* const each : blocks) free(each);
  }
  BehindZeros(const BehindZeros&) = delete;
  BehindZeros& operator=(const BehindZeros&) = delete;
};

sigjmp_buf after_abort;

// docs/heaphook.md says which calls of such a library are safe, and how the others end.
HOOKED_TEST(HookLifetime, ALibraryWithDeepBindingUsesLibcsMalloc) {
  WindowFile file(256 * MiB);
  attach(file);
  const std::string path = std::string(AGNOCAST_TEST_PROGRAMS) + "/libhook_test_deep.so";
  void* const module = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL | RTLD_DEEPBIND);
  ASSERT_NE(module, nullptr) << dlerror();
  const auto allocate = reinterpret_cast<void* (*)(std::size_t)>(dlsym(module, "deep_allocate"));
  const auto release = reinterpret_cast<void (*)(void*)>(dlsym(module, "deep_release"));
  ASSERT_NE(allocate, nullptr);
  ASSERT_NE(release, nullptr);

  hook().enter();
  void* const its_own = allocate(1000);
  hook().leave();
  EXPECT_FALSE(is_shared(its_own));
  free(its_own);
  release(malloc(1000));

  // libc trusts the bytes before the block: with zeros there it sees that the block is not its
  // own.
  const BehindZeros shared;
  ASSERT_NE(shared.block, nullptr);
  ASSERT_TRUE(is_shared(shared.block));
  signal(SIGABRT, [](int) { siglongjmp(after_abort, 1); });
  testing::internal::CaptureStderr();
  if (sigsetjmp(after_abort, 1) == 0) {
    release(shared.block);
    ADD_FAILURE() << "libc accepts the block";
  }
  signal(SIGABRT, SIG_DFL);
  EXPECT_NE(testing::internal::GetCapturedStderr().find("free(): invalid pointer"),
            std::string::npos);
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

HOOKED_TEST(HookLifetime, TheHookItselfCannotBeUnloaded) {
  void* const handle = dlopen(hook_test::hook_path().c_str(), RTLD_NOW);
  ASSERT_NE(handle, nullptr);
  dlclose(handle);
  dlclose(handle);
  void* const block = malloc(100);
  EXPECT_NE(opaque(block), nullptr);
  free(block);
}

// --- the end ------------------------------------------------------------------------------------

void check_at_exit(bool good, int code) {
  if (!good) _exit(code);
}

struct UsesHeapInItsDestructor {
  std::string text;
  std::vector<int>* numbers = nullptr;
  ~UsesHeapInItsDestructor() {
    if (numbers == nullptr) return;
    check_at_exit(is_shared(numbers) && numbers->size() == 1000 && (*numbers)[999] == 999, 41);
    delete numbers;
    Scope scope;
    const std::string late(300, 'l');
    check_at_exit(is_shared(late.data()) && !is_shared(text.data()), 42);
    text = late;
  }
};
UsesHeapInItsDestructor global;

HOOKED_TEST(HookLifetime, ExitHandlersAndStaticDestructorsUseTheHeap) {
  static WindowFile file(64 * MiB);
  attach(file);
  global.text = std::string(100, 'g');
  Scope scope;
  global.numbers = new std::vector<int>;
  for (int i = 0; i < 1000; ++i) global.numbers->push_back(i);
  std::atexit([] {
    Scope late;
    void* const block = opaque(malloc(10000));
    check_at_exit(is_shared(block), 43);
    free(block);
    std::thread([] {
      Scope own;
      free(opaque(malloc(100)));
    }).join();
    check_at_exit(hook_test::usage().internal_error_count == 0, 44);
  });
}

HOOKED_TEST(HookLifetime, ExitWhileOtherThreadsAllocateIsClean) {
  static WindowFile file(256 * MiB);
  attach(file);
  for (int t = 0; t < 3; ++t) {
    std::thread([] {
      for (;;) {
        Scope scope;
        free(opaque(malloc(1000)));
        free(opaque(malloc(100000)));
      }
    }).detach();
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
}

}  // namespace
