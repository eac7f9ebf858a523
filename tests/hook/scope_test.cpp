// SPDX-License-Identifier: Apache-2.0
//
// Goal: which allocations are shared. Method: one attached window; owns() judges the addresses.

#include "support.hpp"

#include <cstdlib>
#include <string>
#include <thread>
#include <vector>

namespace {

using namespace hook_test;

bool malloc_is_shared() {
  void* const block = opaque(malloc(100));
  const bool shared = is_shared(block);
  free(block);
  return shared;
}

HOOKED_TEST(HookScope, TableNamesItsVersion) {
  EXPECT_EQ(hook().abi_version, AGNOCAST_HEAPHOOK_ABI_VERSION);
  EXPECT_EQ(hook().size_bytes, sizeof(agnocast_heaphook_table));
}

HOOKED_TEST(HookScope, ScopesBeforeAttachChangeNothing) {
  EXPECT_FALSE(malloc_is_shared());
  {
    Scope scope;
    EXPECT_EQ(hook().active(), 0);
    EXPECT_FALSE(malloc_is_shared());
  }
  EXPECT_EQ(hook_test::usage().window_count, 0u);
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

HOOKED_TEST(HookScope, LoanSharesOnlyInsideScopes) {
  WindowFile file(64 * MiB);
  attach(file);
  EXPECT_FALSE(malloc_is_shared());
  EXPECT_EQ(hook().active(), 0);
  {
    Scope scope;
    EXPECT_EQ(hook().active(), 1);
    EXPECT_TRUE(malloc_is_shared());
  }
  EXPECT_EQ(hook().active(), 0);
  EXPECT_FALSE(malloc_is_shared());
}

HOOKED_TEST(HookScope, TheTableAllocatesInAnyScope) {
  EXPECT_EQ(hook().allocate(16, 100), nullptr) << "the hook is inert";
  WindowFile file(4 * MiB);
  attach(file);
  void* const block = hook().allocate(16, 100);
  EXPECT_TRUE(is_shared(block));
  EXPECT_FALSE(malloc_is_shared()) << "no scope was opened";
  EXPECT_EQ(hook().deallocate(block), 1);
  void* const aligned = hook().allocate(4096, 1);
  EXPECT_TRUE(is_shared(aligned));
  EXPECT_EQ(reinterpret_cast<std::uintptr_t>(aligned) % 4096, 0u);
  free(aligned);

  void* const of_libc = opaque(malloc(100));
  EXPECT_EQ(hook().deallocate(of_libc), 0) << "a block of libc is left alone";
  free(of_libc);
  EXPECT_EQ(hook().deallocate(nullptr), 0);

  hook().pause();
  EXPECT_EQ(hook().allocate(16, 100), nullptr);
  hook().resume();
  const std::uint64_t spilled = hook().spilled();
  EXPECT_EQ(hook().allocate(16, 64 * MiB), nullptr) << "no room, and never memory of libc";
  EXPECT_EQ(hook().spilled(), spilled + 1);
  EXPECT_EQ(hook_test::usage().live_bytes, 0u);
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

HOOKED_TEST(HookScope, ScopesNest) {
  WindowFile file(64 * MiB);
  attach(file);
  for (int i = 0; i < 1000; ++i) hook().enter();
  for (int i = 0; i < 1000; ++i) {
    ASSERT_TRUE(malloc_is_shared()) << i;
    hook().leave();
  }
  EXPECT_FALSE(malloc_is_shared());
}

HOOKED_TEST(HookScope, PauseNestsInsideAScope) {
  WindowFile file(64 * MiB);
  attach(file);
  Scope scope;
  hook().pause();
  EXPECT_FALSE(malloc_is_shared());
  {
    Scope inner;  // opening another loan does not end a pause
    EXPECT_FALSE(malloc_is_shared());
  }
  hook().pause();
  hook().resume();
  EXPECT_FALSE(malloc_is_shared());
  hook().resume();
  EXPECT_TRUE(malloc_is_shared());
}

HOOKED_TEST(HookScope, OneLeaveTooManyIsCountedAndHarmless) {
  WindowFile file(64 * MiB);
  attach(file);
  hook().leave();
  hook().resume();
  EXPECT_EQ(hook_test::usage().internal_error_count, 2u);
  EXPECT_FALSE(malloc_is_shared());
  Scope scope;
  EXPECT_TRUE(malloc_is_shared());
}

HOOKED_TEST(HookScope, AScopeBelongsToOneThread) {
  WindowFile file(64 * MiB);
  attach(file);
  bool before = true;
  bool inside = false;
  {
    Scope scope;
    std::thread([&] {
      before = malloc_is_shared();
      Scope own;
      inside = malloc_is_shared();
    }).join();
    EXPECT_TRUE(malloc_is_shared());
  }
  EXPECT_FALSE(before);
  EXPECT_TRUE(inside);
  EXPECT_FALSE(malloc_is_shared());
}

HOOKED_TEST(HookScope, AllSharesEverythingAfterAttach) {
  void* const early = opaque(malloc(100));
  WindowFile file(64 * MiB);
  attach(file, AGNOCAST_HEAPHOOK_SCOPE_ALL);
  EXPECT_FALSE(is_shared(early));
  free(early);
  EXPECT_TRUE(malloc_is_shared());
  bool other = false;
  std::thread([&] { other = malloc_is_shared(); }).join();
  EXPECT_TRUE(other);
  hook().pause();
  EXPECT_FALSE(malloc_is_shared());
  hook().resume();
  const std::string text(1000, 'x');
  EXPECT_TRUE(is_shared(text.data()));
}

HOOKED_TEST(HookScope, ContainersOfAMessageAreShared) {
  WindowFile file(64 * MiB);
  attach(file);
  std::vector<std::string> message;
  {
    Scope scope;
    for (int i = 0; i < 1000; ++i)
      message.push_back(std::string(static_cast<std::size_t>(i + 32), 'a'));
  }
  EXPECT_TRUE(is_shared(message.data()));
  for (const std::string& text : message) ASSERT_TRUE(is_shared(text.data()));
  message.clear();
  message.shrink_to_fit();
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

HOOKED_TEST(HookScope, OwnsIsExactAtTheBoundaries) {
  WindowFile file(64 * MiB);
  attach(file);
  char* const base = static_cast<char*>(file.window.base);
  const std::uint64_t frontier = hook().frontier(0);
  EXPECT_GT(frontier, 0u);
  EXPECT_LT(frontier, file.window.length);
  EXPECT_EQ(hook().owns(base), 1);
  EXPECT_EQ(hook().owns(base + frontier - 1), 1);
  EXPECT_EQ(hook().owns(base + frontier), 0);
  EXPECT_EQ(hook().owns(base - 1), 0);
  EXPECT_EQ(hook().owns(nullptr), 0);
  EXPECT_EQ(hook().owns(&file), 0);
  EXPECT_EQ(hook().frontier(1), 0u);
  EXPECT_EQ(hook().frontier(1000), 0u);
}

}  // namespace
