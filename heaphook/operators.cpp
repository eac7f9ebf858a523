// SPDX-License-Identifier: Apache-2.0
//
// C++ operator new and delete, all replaceable forms.
//
// new tries the windows if the thread is in scope; otherwise it calls the *next* definition
// (RTLD_NEXT: libstdc++'s, or one of the user's libraries). That one throws bad_alloc and calls
// new-handlers as it would without the hook, which therefore needs no C++ runtime. A program that
// defines operator new itself never gets here.
//
// A C program may load C++ later and privately (python and its extension modules): the look-up
// then finds no next definition. In that case the hook does what libstdc++ does, malloc and free;
// only if malloc fails does it call operator new of the runtime, which must be loaded by then, to
// throw. The choice is made once, because a block must be deleted the way it was made.
//
// An exception of the next definition, or of on_no_room, passes through these frames: the file is
// built with unwind tables, and nothing here needs cleaning up.

#include "libc_heap.hpp"
#include "route.hpp"
#include "shared_heap.hpp"
#include "thread_state.hpp"

#include <dlfcn.h>
#include <string.h>

#include <atomic>
#include <cstddef>
#include <new>

// Through the dynamic symbol, not route:: — the program may have a malloc of its own, which owns
// such blocks.
extern "C" void* malloc(std::size_t size);
extern "C" void free(void* block);
extern "C" int posix_memalign(void** result, std::size_t alignment, std::size_t size);

namespace {

namespace route = agnocast::heaphook::route;
namespace windows = agnocast::heaphook::windows;
namespace shared_heap = agnocast::heaphook::shared_heap;

using Align = std::align_val_t;
using Nothrow = const std::nothrow_t&;

struct Next {
  void* (*new_)(std::size_t);
  void* (*new_array)(std::size_t);
  void* (*new_nothrow)(std::size_t, Nothrow);
  void* (*new_array_nothrow)(std::size_t, Nothrow);
  void* (*new_aligned)(std::size_t, Align);
  void* (*new_array_aligned)(std::size_t, Align);
  void* (*new_aligned_nothrow)(std::size_t, Align, Nothrow);
  void* (*new_array_aligned_nothrow)(std::size_t, Align, Nothrow);
  void (*delete_)(void*);
  void (*delete_array)(void*);
  void (*delete_sized)(void*, std::size_t);
  void (*delete_array_sized)(void*, std::size_t);
  void (*delete_nothrow)(void*, Nothrow);
  void (*delete_array_nothrow)(void*, Nothrow);
  void (*delete_aligned)(void*, Align);
  void (*delete_array_aligned)(void*, Align);
  void (*delete_sized_aligned)(void*, std::size_t, Align);
  void (*delete_array_sized_aligned)(void*, std::size_t, Align);
  void (*delete_aligned_nothrow)(void*, Align, Nothrow);
  void (*delete_array_aligned_nothrow)(void*, Align, Nothrow);
};

constinit Next next_operators = {};
constinit std::atomic<bool> next_ready{false};

template <typename F>
bool look_up(F& slot, void* library, const char* name) {
  void* const found = dlsym(library, name);
  F function = nullptr;
  static_assert(sizeof function == sizeof found);
  memcpy(&function, &found, sizeof function);
  __atomic_store_n(&slot, function, __ATOMIC_RELAXED);
  return found != nullptr;
}

void look_up_all(Next& next, void* library) {
  if (!look_up(next.new_, library, "_Znwm"))
    return;  // no C++ runtime: the other names would not be found either
  look_up(next.new_array, library, "_Znam");
  look_up(next.new_nothrow, library, "_ZnwmRKSt9nothrow_t");
  look_up(next.new_array_nothrow, library, "_ZnamRKSt9nothrow_t");
  look_up(next.new_aligned, library, "_ZnwmSt11align_val_t");
  look_up(next.new_array_aligned, library, "_ZnamSt11align_val_t");
  look_up(next.new_aligned_nothrow, library, "_ZnwmSt11align_val_tRKSt9nothrow_t");
  look_up(next.new_array_aligned_nothrow, library, "_ZnamSt11align_val_tRKSt9nothrow_t");
  look_up(next.delete_, library, "_ZdlPv");
  look_up(next.delete_array, library, "_ZdaPv");
  look_up(next.delete_sized, library, "_ZdlPvm");
  look_up(next.delete_array_sized, library, "_ZdaPvm");
  look_up(next.delete_nothrow, library, "_ZdlPvRKSt9nothrow_t");
  look_up(next.delete_array_nothrow, library, "_ZdaPvRKSt9nothrow_t");
  look_up(next.delete_aligned, library, "_ZdlPvSt11align_val_t");
  look_up(next.delete_array_aligned, library, "_ZdaPvSt11align_val_t");
  look_up(next.delete_sized_aligned, library, "_ZdlPvmSt11align_val_t");
  look_up(next.delete_array_sized_aligned, library, "_ZdaPvmSt11align_val_t");
  look_up(next.delete_aligned_nothrow, library, "_ZdlPvSt11align_val_tRKSt9nothrow_t");
  look_up(next.delete_array_aligned_nothrow, library, "_ZdaPvSt11align_val_tRKSt9nothrow_t");
}

const Next& next() {
  if (!next_ready.load(std::memory_order_acquire)) [[unlikely]] {
    look_up_all(next_operators, RTLD_NEXT);
    next_ready.store(true, std::memory_order_release);
  }
  return next_operators;
}

// 102: after the malloc family, before the constructors of applications.
[[gnu::constructor(102)]] void look_up_early() { next(); }

// Out of memory without a next operator new: the runtime of the caller is loaded by now, possibly
// privately.
void* fail_as_the_runtime_does(std::size_t size) {
  for (const char* name : {"libstdc++.so.6", "libc++.so.1"}) {
    void* const runtime = dlopen(name, RTLD_LAZY | RTLD_NOLOAD);
    if (runtime == nullptr) continue;
    void* (*runtime_new)(std::size_t) = nullptr;
    const bool found = look_up(runtime_new, runtime, "_Znwm");
    dlclose(runtime);  // releases the reference of NOLOAD; the library stays
    if (found) return runtime_new(size);
  }
  return nullptr;
}

void* plain_new(std::size_t size) {
  void* const block = malloc(size == 0 ? 1 : size);
  return block != nullptr ? block : fail_as_the_runtime_does(size);
}

void* plain_new_nothrow(std::size_t size) { return malloc(size == 0 ? 1 : size); }

void* plain_new_aligned_nothrow(std::size_t size, Align alignment) {
  void* block = nullptr;
  const auto bytes = static_cast<std::size_t>(alignment);
  return posix_memalign(&block, bytes < sizeof(void*) ? sizeof(void*) : bytes,
                        size == 0 ? 1 : size) == 0
             ? block
             : nullptr;
}

void* plain_new_aligned(std::size_t size, Align alignment) {
  void* const block = plain_new_aligned_nothrow(size, alignment);
  return block != nullptr ? block : fail_as_the_runtime_does(size);
}

// One form of new: the windows, else the next definition, else the plain one.
template <typename... Rest>
inline void* form_of_new(void* (*Next::*member)(std::size_t, Rest...), void* shared,
                         void* (*plain)(std::size_t), std::size_t size, Rest... rest) {
  if (shared != nullptr) return shared;
  constexpr bool throws = sizeof...(Rest) == 0;  // then it has thrown where it is refused
  if (!throws && route::is_refused()) return nullptr;
  const auto function = next().*member;
  return function != nullptr ? function(size, rest...) : plain(size);
}

template <typename... Rest>
inline void* form_of_aligned_new(void* (*Next::*member)(std::size_t, Align, Rest...),
                                 void* (*plain)(std::size_t, Align), std::size_t size,
                                 Align alignment, Rest... rest) {
  constexpr bool throws = sizeof...(Rest) == 0;
  const auto bytes = static_cast<std::size_t>(alignment);
  void* const shared = throws ? route::try_shared_aligned_or_throw(bytes, size)
                              : route::try_shared_aligned(bytes, size);
  if (shared != nullptr) return shared;
  if (!throws && route::is_refused()) return nullptr;
  const auto function = next().*member;
  return function != nullptr ? function(size, alignment, rest...) : plain(size, alignment);
}

template <typename... Rest>
inline void form_of_delete(void (*Next::*member)(void*, Rest...), void* block, Rest... rest) {
  if (block == nullptr) return;
  if (const windows::Window* const window = windows::window_of(block)) {
    shared_heap::release(block, *window);
    return;
  }
  const auto function = next().*member;
  function != nullptr ? function(block, rest...) : free(block);
}

}  // namespace

#define AGNOCAST_INTERPOSED __attribute__((visibility("default")))

AGNOCAST_INTERPOSED void* operator new(std::size_t size) {
  return form_of_new(&Next::new_, route::try_shared_or_throw(size), plain_new, size);
}
AGNOCAST_INTERPOSED void* operator new[](std::size_t size) {
  return form_of_new(&Next::new_array, route::try_shared_or_throw(size), plain_new, size);
}
AGNOCAST_INTERPOSED void* operator new(std::size_t size, Nothrow tag) noexcept {
  return form_of_new<Nothrow>(&Next::new_nothrow, route::try_shared(size), plain_new_nothrow, size,
                              tag);
}
AGNOCAST_INTERPOSED void* operator new[](std::size_t size, Nothrow tag) noexcept {
  return form_of_new<Nothrow>(&Next::new_array_nothrow, route::try_shared(size), plain_new_nothrow,
                              size, tag);
}
AGNOCAST_INTERPOSED void* operator new(std::size_t size, Align alignment) {
  return form_of_aligned_new(&Next::new_aligned, plain_new_aligned, size, alignment);
}
AGNOCAST_INTERPOSED void* operator new[](std::size_t size, Align alignment) {
  return form_of_aligned_new(&Next::new_array_aligned, plain_new_aligned, size, alignment);
}
AGNOCAST_INTERPOSED void* operator new(std::size_t size, Align alignment, Nothrow tag) noexcept {
  return form_of_aligned_new<Nothrow>(&Next::new_aligned_nothrow, plain_new_aligned_nothrow, size,
                                      alignment, tag);
}
AGNOCAST_INTERPOSED void* operator new[](std::size_t size, Align alignment, Nothrow tag) noexcept {
  return form_of_aligned_new<Nothrow>(&Next::new_array_aligned_nothrow, plain_new_aligned_nothrow,
                                      size, alignment, tag);
}

AGNOCAST_INTERPOSED void operator delete(void* block) noexcept {
  form_of_delete(&Next::delete_, block);
}
AGNOCAST_INTERPOSED void operator delete[](void* block) noexcept {
  form_of_delete(&Next::delete_array, block);
}
AGNOCAST_INTERPOSED void operator delete(void* block, std::size_t size) noexcept {
  form_of_delete(&Next::delete_sized, block, size);
}
AGNOCAST_INTERPOSED void operator delete[](void* block, std::size_t size) noexcept {
  form_of_delete(&Next::delete_array_sized, block, size);
}
AGNOCAST_INTERPOSED void operator delete(void* block, Nothrow tag) noexcept {
  form_of_delete<Nothrow>(&Next::delete_nothrow, block, tag);
}
AGNOCAST_INTERPOSED void operator delete[](void* block, Nothrow tag) noexcept {
  form_of_delete<Nothrow>(&Next::delete_array_nothrow, block, tag);
}
AGNOCAST_INTERPOSED void operator delete(void* block, Align alignment) noexcept {
  form_of_delete(&Next::delete_aligned, block, alignment);
}
AGNOCAST_INTERPOSED void operator delete[](void* block, Align alignment) noexcept {
  form_of_delete(&Next::delete_array_aligned, block, alignment);
}
AGNOCAST_INTERPOSED void operator delete(void* block, std::size_t size, Align alignment) noexcept {
  form_of_delete(&Next::delete_sized_aligned, block, size, alignment);
}
AGNOCAST_INTERPOSED void operator delete[](void* block, std::size_t size,
                                           Align alignment) noexcept {
  form_of_delete(&Next::delete_array_sized_aligned, block, size, alignment);
}
AGNOCAST_INTERPOSED void operator delete(void* block, Align alignment, Nothrow tag) noexcept {
  form_of_delete<Align, Nothrow>(&Next::delete_aligned_nothrow, block, alignment, tag);
}
AGNOCAST_INTERPOSED void operator delete[](void* block, Align alignment, Nothrow tag) noexcept {
  form_of_delete<Align, Nothrow>(&Next::delete_array_aligned_nothrow, block, alignment, tag);
}
