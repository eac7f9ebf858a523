// SPDX-License-Identifier: Apache-2.0
//
// Libc heap: the *next* definition of the malloc family behind ours (libc's, or that of another
// preloaded allocator).
//
// A constructor looks the definitions up once, by dlsym(RTLD_NEXT); a thread that allocates
// before that constructor does the look-up itself. dlsym may allocate: a thread inside the
// look-up gets memory from a small static buffer that is never freed. After the look-up a call
// costs one load and one indirect jump.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

namespace agnocast::heaphook::libc_heap {

struct Functions {
  void* (*malloc)(std::size_t);
  void* (*calloc)(std::size_t, std::size_t);
  void* (*realloc)(void*, std::size_t);
  void (*free)(void*);
  int (*posix_memalign)(void**, std::size_t, std::size_t);
  void* (*aligned_alloc)(std::size_t, std::size_t);
  void* (*memalign)(std::size_t, std::size_t);
  void* (*valloc)(std::size_t);
  void* (*pvalloc)(std::size_t);
  std::size_t (*malloc_usable_size)(void*);
};

// 16 KiB: glibc's dlsym needs about 100 bytes (the text of a failed look-up); the rest is for
// other libcs and loaders.
inline constexpr std::size_t bootstrap_size_bytes = 16 * 1024;
extern char bootstrap_buffer[bootstrap_size_bytes];

extern constinit Functions next_functions;
extern constinit std::atomic<bool> next_ready;

// Looks up the next definitions and returns them; returns the bootstrap functions to a thread
// inside the look-up.
const Functions& resolve();

inline const Functions& next() {
  if (next_ready.load(std::memory_order_acquire)) [[likely]]
    return next_functions;
  return resolve();
}

inline bool from_bootstrap(const void* address) {
  return reinterpret_cast<std::uintptr_t>(address) -
             reinterpret_cast<std::uintptr_t>(bootstrap_buffer) <
         bootstrap_size_bytes;
}

// Returns the usable bytes of a bootstrap block.
std::size_t bootstrap_usable_size(const void* block);

}  // namespace agnocast::heaphook::libc_heap
