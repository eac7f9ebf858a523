// SPDX-License-Identifier: Apache-2.0
//
// Goal: every function of the malloc family works in and out of scope, in any thread and across
// the two heaps, with libc's errors.
// Method: addresses and contents; for odd arguments the result and errno of libc's own function.

#include "support.hpp"

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <thread>

#include <dlfcn.h>
#include <malloc.h>
#include <unistd.h>

namespace {

using namespace hook_test;

struct Maker {
  const char* name;
  std::function<void*(std::size_t)> make;
  std::size_t alignment;
};

void* posix(std::size_t alignment, std::size_t size) {
  void* block = nullptr;
  return posix_memalign(&block, alignment, size) == 0 ? block : nullptr;
}

const std::size_t page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));

const Maker makers[] = {
    {"malloc", [](std::size_t n) { return malloc(n); }, 16},
    {"calloc", [](std::size_t n) { return calloc(1, n); }, 16},
    {"realloc(NULL)", [](std::size_t n) { return realloc(nullptr, n); }, 16},
    {"reallocarray(NULL)", [](std::size_t n) { return reallocarray(nullptr, n, 1); }, 16},
    {"posix_memalign 64", [](std::size_t n) { return posix(64, n); }, 64},
    {"posix_memalign 1 MiB", [](std::size_t n) { return posix(MiB, n); }, MiB},
    {"aligned_alloc 256", [](std::size_t n) { return aligned_alloc(256, n); }, 256},
    {"memalign 4096", [](std::size_t n) { return memalign(4096, n); }, 4096},
    {"valloc", [](std::size_t n) { return valloc(n); }, 4096},
    {"pvalloc", [](std::size_t n) { return pvalloc(n); }, 4096},
};

HOOKED_TEST(HookFamily, EveryMakerIsSharedInScopeAndAligned) {
  WindowFile file(512 * MiB);
  attach(file);
  for (const Maker& maker : makers) {
    for (std::size_t size : {0ul, 1ul, 8ul, 15ul, 16ul, 100ul, 4096ul, 5000ul, 65537ul, 3 * MiB}) {
      SCOPED_TRACE(std::string(maker.name) + " " + std::to_string(size));
      void* block = nullptr;
      {
        Scope scope;
        block = opaque(maker.make(size));
      }
      ASSERT_NE(block, nullptr);
      ASSERT_TRUE(is_shared(block));
      ASSERT_EQ(reinterpret_cast<std::uintptr_t>(block) % maker.alignment, 0u);
      ASSERT_GE(malloc_usable_size(block), size);
      std::memset(block, 0x5a, malloc_usable_size(block));
      free(block);

      void* const plain = opaque(maker.make(size));
      ASSERT_NE(plain, nullptr);
      ASSERT_FALSE(is_shared(plain));
      ASSERT_GE(malloc_usable_size(plain), size);
      free(plain);
    }
  }
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

HOOKED_TEST(HookFamily, PvallocRoundsUpToPages) {
  WindowFile file(64 * MiB);
  attach(file);
  Scope scope;
  void* const block = pvalloc(page + 1);
  EXPECT_GE(malloc_usable_size(block), 2 * page);
  free(block);
}

HOOKED_TEST(HookFamily, CallocIsZeroAlsoOnReusedMemory) {
  WindowFile file(256 * MiB);
  attach(file);
  Scope scope;
  for (std::size_t size : {24ul, 4096ul, 100000ul, 5 * MiB}) {
    for (int round = 0; round < 3; ++round) {
      auto* const block = static_cast<unsigned char*>(calloc(size / 8, 8));
      ASSERT_TRUE(is_shared(block));
      for (std::size_t i = 0; i < size / 8 * 8; ++i) ASSERT_EQ(block[i], 0) << size;
      std::memset(block, 0xff, size / 8 * 8);
      free(block);
      if (round == 1) hook().purge();
    }
  }
}

HOOKED_TEST(HookFamily, FreeAndUsableSizeWorkInAnyThread) {
  WindowFile file(64 * MiB);
  attach(file);
  for (std::size_t size : {1ul, 1000ul, 3 * MiB}) {
    void* block = nullptr;
    {
      Scope scope;
      block = opaque(malloc(size));
    }
    ASSERT_TRUE(is_shared(block));
    std::thread([&] {
      EXPECT_GE(malloc_usable_size(block), size);
      free(block);
    }).join();
    void* plain = opaque(malloc(size));
    std::thread([&] {
      Scope scope;
      EXPECT_GE(malloc_usable_size(plain), size);
      free(plain);
    }).join();
  }
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

HOOKED_TEST(HookFamily, FreeKeepsErrno) {
  WindowFile file(64 * MiB);
  attach(file);
  void* block = nullptr;
  {
    Scope scope;
    block = opaque(malloc(100));
  }
  errno = 4711;
  free(block);
  EXPECT_EQ(errno, 4711);
  free(nullptr);
  EXPECT_EQ(errno, 4711);
}

// Checks realloc's content over all sizes, growing and shrinking, for a block made inside (shared)
// or outside a scope.
void realloc_walk(bool made_in_scope, bool changed_in_scope, bool expect_shared_after) {
  for (std::size_t from : {1ul, 100ul, 5000ul, 2 * MiB}) {
    for (std::size_t to : {1ul, 90ul, 6000ul, 3 * MiB}) {
      SCOPED_TRACE(std::to_string(from) + " to " + std::to_string(to));
      if (made_in_scope) hook().enter();
      auto* block = static_cast<unsigned char*>(malloc(from));
      if (made_in_scope) hook().leave();
      ASSERT_EQ(is_shared(block), made_in_scope);
      for (std::size_t i = 0; i < from; ++i) block[i] = static_cast<unsigned char>(i * 7);
      std::thread([&] {
        if (changed_in_scope) hook().enter();
        block = static_cast<unsigned char*>(realloc(block, to));
        if (changed_in_scope) hook().leave();
      }).join();
      ASSERT_NE(block, nullptr);
      EXPECT_EQ(is_shared(block), expect_shared_after);
      for (std::size_t i = 0; i < (from < to ? from : to); ++i)
        ASSERT_EQ(block[i], static_cast<unsigned char>(i * 7));
      std::memset(block, 1, to);
      free(block);
    }
  }
}

HOOKED_TEST(HookFamily, ReallocOfASharedBlockStaysSharedInAnyThread) {
  WindowFile file(512 * MiB);
  attach(file);
  realloc_walk(true, false, true);
  realloc_walk(true, true, true);
}

HOOKED_TEST(HookFamily, ReallocInScopeMovesALibcBlockIntoTheWindow) {
  WindowFile file(512 * MiB);
  attach(file);
  realloc_walk(false, true, true);
  realloc_walk(false, false, false);
}

HOOKED_TEST(HookFamily, ReallocOfASharedBlockMovesToLibcWhenTheWindowIsFull) {
  WindowFile file(4 * MiB);
  attach(file);
  auto* block = static_cast<unsigned char*>(nullptr);
  {
    Scope scope;
    block = static_cast<unsigned char*>(malloc(MiB));
  }
  ASSERT_TRUE(is_shared(block));
  std::memset(block, 0x77, MiB);
  block = static_cast<unsigned char*>(realloc(block, 16 * MiB));
  ASSERT_NE(block, nullptr);
  EXPECT_FALSE(is_shared(block));
  for (std::size_t i = 0; i < MiB; ++i) ASSERT_EQ(block[i], 0x77);
  free(block);
}

HOOKED_TEST(HookFamily, ReallocToZeroFreesAsInLibc) {
  WindowFile file(64 * MiB);
  attach(file);
  const auto libc_realloc = libc_function<void* (*)(void*, std::size_t)>("realloc");
  const auto libc_malloc = libc_function<void* (*)(std::size_t)>("malloc");
  void* const expected = libc_realloc(libc_malloc(100), 0);
  Scope scope;
  const std::uint64_t before = hook_test::usage().live_bytes;
  EXPECT_EQ(realloc(opaque(malloc(100000)), 0), expected);
  EXPECT_EQ(reallocarray(opaque(malloc(100000)), 0, 10), expected);
  EXPECT_EQ(hook_test::usage().live_bytes, before);
}

HOOKED_TEST(HookFamily, AFailedReallocKeepsTheBlock) {
  WindowFile file(64 * MiB);
  attach(file);
  for (bool shared : {true, false}) {
    if (shared) hook().enter();
    auto* const block = static_cast<unsigned char*>(malloc(1000));
    if (shared) hook().leave();
    std::memset(block, 0x42, 1000);
    errno = 0;
    EXPECT_EQ(realloc(block, SIZE_MAX / 2 + 100), nullptr);
    EXPECT_EQ(errno, ENOMEM);
    errno = 0;
    EXPECT_EQ(reallocarray(block, SIZE_MAX / 2, 3), nullptr);
    EXPECT_EQ(errno, ENOMEM);
    for (int i = 0; i < 1000; ++i) ASSERT_EQ(block[i], 0x42);
    free(block);
  }
}

constexpr std::size_t largest = PTRDIFF_MAX;
const std::size_t odd_sizes[] = {0, largest, largest + 1, SIZE_MAX - page, SIZE_MAX - 15, SIZE_MAX};
const std::size_t odd_alignments[] = {0, 1, 2, 4, 8, 24, 48, largest, largest + 1};

// Compares our functions with libc's for invalid and boundary arguments, in scope and out of it.
// Long because each function of the family has its odd arguments.
HOOKED_TEST(HookFamily, OddArgumentsGiveTheResultsOfLibc) {
  WindowFile file(64 * MiB);
  attach(file);
  const auto libc_malloc = libc_function<void* (*)(std::size_t)>("malloc");
  const auto libc_calloc = libc_function<void* (*)(std::size_t, std::size_t)>("calloc");
  const auto libc_posix_memalign =
      libc_function<int (*)(void**, std::size_t, std::size_t)>("posix_memalign");
  const auto libc_aligned_alloc =
      libc_function<void* (*)(std::size_t, std::size_t)>("aligned_alloc");
  const auto libc_memalign = libc_function<void* (*)(std::size_t, std::size_t)>("memalign");
  const auto libc_valloc = libc_function<void* (*)(std::size_t)>("valloc");
  const auto libc_pvalloc = libc_function<void* (*)(std::size_t)>("pvalloc");
  const auto libc_usable = libc_function<std::size_t (*)(void*)>("malloc_usable_size");

  const auto compare = [](const char* what, auto ours, auto theirs) {
    errno = 0;
    void* const mine = opaque(ours());
    const int my_errno = errno;
    errno = 0;
    void* const libcs = opaque(theirs());
    const int libc_errno = errno;
    EXPECT_EQ(mine == nullptr, libcs == nullptr) << what;
    EXPECT_EQ(my_errno, libc_errno) << what;
    free(mine);
    free(libcs);
  };
  for (bool in_scope : {false, true}) {
    SCOPED_TRACE(in_scope ? "in scope" : "out of scope");
    if (in_scope) hook().enter();
    for (std::size_t size : odd_sizes) {
      SCOPED_TRACE(size);
      compare(
          "malloc", [&] { return malloc(size); }, [&] { return libc_malloc(size); });
      compare(
          "calloc", [&] { return calloc(1, size); }, [&] { return libc_calloc(1, size); });
      compare(
          "aligned_alloc", [&] { return aligned_alloc(64, size); },
          [&] { return libc_aligned_alloc(64, size); });
      compare(
          "memalign", [&] { return memalign(64, size); }, [&] { return libc_memalign(64, size); });
      compare(
          "valloc", [&] { return valloc(size); }, [&] { return libc_valloc(size); });
      compare(
          "pvalloc", [&] { return pvalloc(size); }, [&] { return libc_pvalloc(size); });
    }
    compare(
        "calloc overflow", [] { return calloc(SIZE_MAX / 2, 3); },
        [&] { return libc_calloc(SIZE_MAX / 2, 3); });
    compare(
        "calloc 0 * 8", [] { return calloc(0, 8); }, [&] { return libc_calloc(0, 8); });
    for (std::size_t alignment : odd_alignments) {
      SCOPED_TRACE(alignment);
      void* mine = &mine;
      void* libcs = &libcs;
      errno = 0;
      const int my_answer = posix_memalign(&mine, alignment, 100);
      const int my_errno = errno;
      errno = 0;
      EXPECT_EQ(my_answer, libc_posix_memalign(&libcs, alignment, 100));
      EXPECT_EQ(my_errno, errno);
      if (my_answer == 0) {
        free(mine);
        free(libcs);
      } else {
        EXPECT_EQ(mine, &mine) << "untouched on failure";
      }
      compare(
          "aligned_alloc", [&] { return aligned_alloc(alignment, 100); },
          [&] { return libc_aligned_alloc(alignment, 100); });
      compare(
          "memalign", [&] { return memalign(alignment, 100); },
          [&] { return libc_memalign(alignment, 100); });
    }
    EXPECT_EQ(malloc_usable_size(nullptr), libc_usable(nullptr));
    if (in_scope) hook().leave();
  }
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

HOOKED_TEST(HookFamily, SizedFreeOfC23Works) {
  WindowFile file(64 * MiB);
  attach(file);
  const auto free_sized =
      reinterpret_cast<void (*)(void*, std::size_t)>(dlsym(RTLD_DEFAULT, "free_sized"));
  const auto free_aligned_sized = reinterpret_cast<void (*)(void*, std::size_t, std::size_t)>(
      dlsym(RTLD_DEFAULT, "free_aligned_sized"));
  ASSERT_NE(free_sized, nullptr);
  ASSERT_NE(free_aligned_sized, nullptr);
  Scope scope;
  const std::uint64_t before = hook_test::usage().live_bytes;
  free_sized(opaque(malloc(100000)), 100000);
  free_aligned_sized(opaque(aligned_alloc(64, 100032)), 64, 100032);
  EXPECT_EQ(hook_test::usage().live_bytes, before);
}

}  // namespace
