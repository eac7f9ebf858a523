// SPDX-License-Identifier: Apache-2.0
//
// Goal: all replaceable forms of operator new and delete share in scope, and keep the standard's
// behaviour everywhere: bad_alloc, nothrow, new-handlers, over-aligned and sized forms, mixed
// scopes.

#include "support.hpp"

#include <cstdlib>
#include <limits>
#include <memory>
#include <new>
#include <string>
#include <thread>
#include <vector>

namespace {

using namespace hook_test;

constexpr std::align_val_t aligned{128};

struct Form {
  const char* name;
  void* (*make)(std::size_t);
  void (*drop)(void*, std::size_t);
  std::size_t alignment;
};

const Form forms[] = {
    {"new / delete", [](std::size_t n) { return operator new(n); },
     [](void* p, std::size_t) { operator delete(p); }, 16},
    {"new[] / delete[]", [](std::size_t n) { return operator new[](n); },
     [](void* p, std::size_t) { operator delete[](p); }, 16},
    {"new / sized delete", [](std::size_t n) { return operator new(n); },
     [](void* p, std::size_t n) { operator delete(p, n); }, 16},
    {"new[] / sized delete[]", [](std::size_t n) { return operator new[](n); },
     [](void* p, std::size_t n) { operator delete[](p, n); }, 16},
    {"nothrow new / delete", [](std::size_t n) { return operator new(n, std::nothrow); },
     [](void* p, std::size_t) { operator delete(p, std::nothrow); }, 16},
    {"nothrow new[] / delete[]", [](std::size_t n) { return operator new[](n, std::nothrow); },
     [](void* p, std::size_t) { operator delete[](p, std::nothrow); }, 16},
    {"aligned new / delete", [](std::size_t n) { return operator new(n, aligned); },
     [](void* p, std::size_t) { operator delete(p, aligned); }, 128},
    {"aligned new[] / delete[]", [](std::size_t n) { return operator new[](n, aligned); },
     [](void* p, std::size_t) { operator delete[](p, aligned); }, 128},
    {"aligned new / sized delete", [](std::size_t n) { return operator new(n, aligned); },
     [](void* p, std::size_t n) { operator delete(p, n, aligned); }, 128},
    {"aligned new[] / sized delete[]", [](std::size_t n) { return operator new[](n, aligned); },
     [](void* p, std::size_t n) { operator delete[](p, n, aligned); }, 128},
    {"aligned nothrow new / delete",
     [](std::size_t n) { return operator new(n, aligned, std::nothrow); },
     [](void* p, std::size_t) { operator delete(p, aligned, std::nothrow); }, 128},
    {"aligned nothrow new[] / delete[]",
     [](std::size_t n) { return operator new[](n, aligned, std::nothrow); },
     [](void* p, std::size_t) { operator delete[](p, aligned, std::nothrow); }, 128},
};

HOOKED_TEST(HookOperators, EveryFormSharesInScopeAndFreesAnywhere) {
  WindowFile file(256 * MiB);
  attach(file);
  for (const Form& form : forms) {
    for (std::size_t size : {0ul, 1ul, 64ul, 5000ul, 3 * MiB}) {
      SCOPED_TRACE(std::string(form.name) + " " + std::to_string(size));
      hook().enter();
      const std::uint64_t before = hook_test::usage().live_bytes;
      void* const block = opaque(form.make(size));
      hook().leave();
      ASSERT_NE(block, nullptr);
      ASSERT_TRUE(is_shared(block));
      ASSERT_EQ(reinterpret_cast<std::uintptr_t>(block) % form.alignment, 0u);
      form.drop(block, size);
      ASSERT_EQ(hook_test::usage().live_bytes, before);

      void* const plain = opaque(form.make(size));
      ASSERT_NE(plain, nullptr);
      ASSERT_FALSE(is_shared(plain));
      ASSERT_EQ(reinterpret_cast<std::uintptr_t>(plain) % form.alignment, 0u);
      hook().enter();
      form.drop(plain, size);
      hook().leave();
    }
    form.drop(nullptr, 0);
  }
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

HOOKED_TEST(HookOperators, ImpossibleSizesThrowOrReturnNull) {
  WindowFile file(64 * MiB);
  attach(file);
  const std::size_t huge = static_cast<std::size_t>(std::numeric_limits<std::ptrdiff_t>::max());
  for (bool in_scope : {false, true}) {
    if (in_scope) hook().enter();
    EXPECT_THROW(opaque(operator new(huge)), std::bad_alloc);
    EXPECT_THROW(opaque(operator new[](huge)), std::bad_alloc);
    EXPECT_THROW(opaque(operator new(huge, aligned)), std::bad_alloc);
    EXPECT_THROW(opaque(operator new[](huge, aligned)), std::bad_alloc);
    EXPECT_EQ(opaque(operator new(huge, std::nothrow)), nullptr);
    EXPECT_EQ(opaque(operator new[](huge, std::nothrow)), nullptr);
    EXPECT_EQ(opaque(operator new(huge, aligned, std::nothrow)), nullptr);
    EXPECT_EQ(opaque(operator new[](huge, aligned, std::nothrow)), nullptr);
    if (in_scope) hook().leave();
  }
}

int handler_calls = 0;

HOOKED_TEST(HookOperators, NewHandlersAreCalledUntilTheyGiveUp) {
  WindowFile file(64 * MiB);
  attach(file);
  const std::size_t huge = static_cast<std::size_t>(std::numeric_limits<std::ptrdiff_t>::max());
  for (bool in_scope : {false, true}) {
    handler_calls = 0;
    std::set_new_handler([] {
      if (++handler_calls == 3) std::set_new_handler(nullptr);
    });
    if (in_scope) hook().enter();
    EXPECT_THROW(opaque(operator new(huge)), std::bad_alloc);
    if (in_scope) hook().leave();
    EXPECT_EQ(handler_calls, 3);
  }
}

HOOKED_TEST(HookOperators, AFullWindowFallsBackWithoutCallingTheHandler) {
  WindowFile file(2 * MiB);
  attach(file);
  handler_calls = 0;
  std::set_new_handler([] {
    ++handler_calls;
    std::set_new_handler(nullptr);
  });
  Scope scope;
  const std::unique_ptr<char[]> block(new char[8 * MiB]);
  EXPECT_FALSE(is_shared(block.get()));
  EXPECT_EQ(handler_calls, 0);
}

struct Thrower {
  char payload[100];
  Thrower() { throw 1; }
};

HOOKED_TEST(HookOperators, AThrowingConstructorGivesItsMemoryBack) {
  WindowFile file(64 * MiB);
  attach(file);
  Scope scope;
  const std::uint64_t before = hook_test::usage().live_bytes;
  hook().pause();
  hook().resume();
  for (int i = 0; i < 100; ++i) EXPECT_THROW(opaque(new Thrower), int);
  EXPECT_LT(hook_test::usage().live_bytes, before + 10 * sizeof(Thrower));
}

struct alignas(256) Wide {
  char payload[256];
};

struct NoRoom {};
[[noreturn]] void throw_no_room() { throw NoRoom(); }

HOOKED_TEST(HookOperators, CallTheNoRoomHandlerWhereOneIsSet) {
  WindowFile file(8 * MiB);
  attach(file);
  constexpr std::size_t large = 16 * MiB;
  const auto expect_libc = [](void* block, auto release) {
    ASSERT_NE(block, nullptr);
    EXPECT_FALSE(is_shared(block));
    release(block);
  };
  const auto plain = [](void* block) { operator delete(block); };
  EXPECT_EQ(hook().on_no_room(throw_no_room), nullptr);
  expect_libc(operator new(large), plain);  // no scope
  {
    Scope scope;
    EXPECT_THROW(opaque(operator new(large)), NoRoom);
    EXPECT_THROW(opaque(operator new[](large)), NoRoom);
    EXPECT_THROW(opaque(operator new(large, aligned)), NoRoom);
    EXPECT_THROW(opaque(operator new[](large, aligned)), NoRoom);
    EXPECT_EQ(opaque(operator new(large, std::nothrow)), nullptr);
    EXPECT_EQ(opaque(operator new[](large, std::nothrow)), nullptr);
    EXPECT_EQ(opaque(operator new(large, aligned, std::nothrow)), nullptr);
    EXPECT_EQ(opaque(operator new[](large, aligned, std::nothrow)), nullptr);
    expect_libc(malloc(large), free);
    void* const fits = opaque(operator new(1000));
    EXPECT_TRUE(is_shared(fits));
    operator delete(fits);
    hook().pause();
    expect_libc(operator new(large), plain);
    hook().resume();
    hook().pause();  // the thread object itself stays out of this scope
    std::thread([&] {
      Scope another;
      expect_libc(operator new(large), plain);  // it has not set on_no_room
    }).join();
    hook().resume();
    EXPECT_EQ(hook().on_no_room(nullptr), throw_no_room);
    expect_libc(operator new(large), plain);
  }
  EXPECT_EQ(hook().active(), 0) << "no scope was left open";
  EXPECT_EQ(hook_test::usage().live_bytes, 0u);
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

HOOKED_TEST(HookOperators, OverAlignedTypesAndContainersWork) {
  WindowFile file(64 * MiB);
  attach(file);
  std::vector<Wide> wide;
  std::unique_ptr<Wide> one;
  {
    Scope scope;
    wide.resize(100);
    one = std::make_unique<Wide>();
  }
  EXPECT_TRUE(is_shared(wide.data()));
  EXPECT_EQ(reinterpret_cast<std::uintptr_t>(wide.data()) % 256, 0u);
  EXPECT_TRUE(is_shared(one.get()));
  wide.resize(1000);  // out of scope: the new buffer is libc's, the old one returns to the window
  EXPECT_FALSE(is_shared(wide.data()));
}

}  // namespace
