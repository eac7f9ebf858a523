// SPDX-License-Identifier: Apache-2.0
//
// Shared heap or libc; see route.hpp.

#include "route.hpp"

#include <errno.h>
#include <string.h>
#include <unistd.h>

namespace agnocast::heaphook::route {

constinit std::atomic<bool> scope_all{false};

namespace {

// Returns the readable bytes of a block that is not shared.
std::size_t private_usable_size(void* block) {
  if (libc_heap::from_bootstrap(block)) return libc_heap::bootstrap_usable_size(block);
  return libc_heap::next().malloc_usable_size(block);
}

// Copies a block to a new home and frees it; if the home is null (no memory), keeps it.
void* move_to(void* home, void* block, std::size_t usable, std::size_t size) {
  if (home == nullptr) return nullptr;
  memcpy(home, block, usable < size ? usable : size);
  release(block);
  return home;
}

std::size_t page_size() { return static_cast<std::size_t>(sysconf(_SC_PAGESIZE)); }

bool is_power_of_two(std::size_t value) { return value != 0 && (value & (value - 1)) == 0; }

}  // namespace

void* try_shared_aligned(std::size_t alignment, std::size_t size) {
  return is_power_of_two(alignment) && wants_shared()
             ? shared_heap::allocate_aligned(alignment, size)
             : nullptr;
}

// The callers hold no resource that an exception would leak.
[[gnu::noinline, gnu::cold]] void say_no_room() {
  if (thread_state.no_room != nullptr) thread_state.no_room();
}

void* allocate_zeroed(std::size_t count, std::size_t size) {
  std::size_t bytes = 0;
  if (wants_shared() && !__builtin_mul_overflow(count, size, &bytes)) {
    if (void* const block = shared_heap::allocate_zeroed(bytes)) return block;
  }
  return libc_heap::next().calloc(count, size);
}

void* reallocate(void* block, std::size_t size) {
  if (block == nullptr) return allocate(size);
  if (windows::window_of(block) != nullptr) {
    if (size == 0) {  // as in glibc: realloc(p, 0) is free
      release(block);
      return nullptr;
    }
    const bool may_stay = windows::is_owner() && !thread_state.forking;
    if (may_stay) {
      if (void* const moved = shared_heap::reallocate(block, size)) return moved;
    }
    return move_to(libc_heap::next().malloc(size), block, shared_heap::usable_size(block), size);
  }
  if (wants_shared() && size != 0) {
    if (void* const home = shared_heap::allocate(size))
      return move_to(home, block, private_usable_size(block), size);
  }
  if (libc_heap::from_bootstrap(block)) {
    return move_to(libc_heap::next().malloc(size), block, private_usable_size(block), size);
  }
  return libc_heap::next().realloc(block, size);
}

void* reallocate_array(void* block, std::size_t count, std::size_t size) {
  std::size_t bytes = 0;
  if (__builtin_mul_overflow(count, size, &bytes)) {
    errno = ENOMEM;
    return nullptr;
  }
  return reallocate(block, bytes);
}

int allocate_posix(void** result, std::size_t alignment, std::size_t size) {
  if (alignment % sizeof(void*) == 0) {
    if (void* const block = try_shared_aligned(alignment, size)) {
      *result = block;
      return 0;
    }
  }
  return libc_heap::next().posix_memalign(result, alignment, size);
}

void* allocate_aligned(std::size_t alignment, std::size_t size,
                       void* (*next)(std::size_t, std::size_t)) {
  if (void* const block = try_shared_aligned(alignment, size)) return block;
  return next(alignment, size);
}

void* allocate_pages(std::size_t size) {
  if (void* const block = try_shared_aligned(page_size(), size)) return block;
  return libc_heap::next().valloc(size);
}

void* allocate_whole_pages(std::size_t size) {
  const std::size_t page = page_size();
  if (size <= PTRDIFF_MAX) {
    if (void* const block = try_shared_aligned(page, (size + page - 1) & ~(page - 1))) return block;
  }
  return libc_heap::next().pvalloc(size);
}

std::size_t usable_size(void* block) {
  if (block == nullptr) return 0;
  return windows::window_of(block) != nullptr ? shared_heap::usable_size(block)
                                              : private_usable_size(block);
}

}  // namespace agnocast::heaphook::route
