// SPDX-License-Identifier: Apache-2.0
//
// Looks up the next malloc family, with a bootstrap buffer that serves the look-up. See
// libc_heap.hpp.

#include "libc_heap.hpp"

#include "thread_state.hpp"

#include <dlfcn.h>
#include <errno.h>
#include <string.h>

namespace agnocast::heaphook::libc_heap {

alignas(64) constinit char bootstrap_buffer[bootstrap_size_bytes] = {};
constinit Functions next_functions = {};
constinit std::atomic<bool> next_ready{false};

namespace {

// A block is preceded by its size in a header of 16 bytes, which keeps malloc's alignment.
constexpr std::size_t header_size = 16;
constinit std::atomic<std::size_t> bootstrap_used{0};

void* bootstrap_aligned(std::size_t alignment, std::size_t size) {
  if (alignment < header_size) alignment = header_size;
  if (size > bootstrap_size_bytes || alignment > bootstrap_size_bytes) {
    errno = ENOMEM;
    return nullptr;
  }
  const std::size_t room = header_size + alignment + ((size + 15) & ~std::size_t{15});
  const std::size_t start = bootstrap_used.fetch_add(room, std::memory_order_relaxed);
  if (start > bootstrap_size_bytes || room > bootstrap_size_bytes - start) {
    errno = ENOMEM;
    return nullptr;
  }
  const std::uintptr_t first =
      reinterpret_cast<std::uintptr_t>(bootstrap_buffer) + start + header_size;
  const std::uintptr_t block = (first + alignment - 1) & ~(alignment - 1);
  void* const pointer =
      bootstrap_buffer + (block - reinterpret_cast<std::uintptr_t>(bootstrap_buffer));
  memcpy(static_cast<char*>(pointer) - header_size, &size, sizeof size);
  return pointer;
}

void* bootstrap_malloc(std::size_t size) { return bootstrap_aligned(header_size, size); }

void* bootstrap_calloc(std::size_t count, std::size_t size) {
  std::size_t bytes = 0;
  if (__builtin_mul_overflow(count, size, &bytes)) {
    errno = ENOMEM;
    return nullptr;
  }
  return bootstrap_malloc(bytes);  // the buffer is zero and every byte is used once
}

void* bootstrap_realloc(void* old, std::size_t size) {
  void* const block = bootstrap_malloc(size);
  if (block == nullptr || old == nullptr) return block;
  const std::size_t old_size = bootstrap_usable_size(old);
  memcpy(block, old, old_size < size ? old_size : size);
  return block;
}

void bootstrap_free(void*) {}

int bootstrap_posix_memalign(void** result, std::size_t alignment, std::size_t size) {
  void* const block = bootstrap_aligned(alignment, size);
  if (block == nullptr) return ENOMEM;
  *result = block;
  return 0;
}

void* bootstrap_page(std::size_t size) { return bootstrap_aligned(4096, size); }

std::size_t bootstrap_size_of(void* block) {
  return block == nullptr ? 0 : bootstrap_usable_size(block);
}

constexpr Functions bootstrap_functions = {
    .malloc = bootstrap_malloc,
    .calloc = bootstrap_calloc,
    .realloc = bootstrap_realloc,
    .free = bootstrap_free,
    .posix_memalign = bootstrap_posix_memalign,
    .aligned_alloc = bootstrap_aligned,
    .memalign = bootstrap_aligned,
    .valloc = bootstrap_page,
    .pvalloc = bootstrap_page,
    .malloc_usable_size = bootstrap_size_of,
};

// Several threads may look up at the same time; they store the same values, so each store only
// has to be atomic.
template <typename F>
void look_up(F& slot, const char* name) {
  void* const found = dlsym(RTLD_NEXT, name);
  F function = nullptr;
  static_assert(sizeof function == sizeof found);
  memcpy(&function, &found, sizeof function);
  __atomic_store_n(&slot, function, __ATOMIC_RELAXED);
}

}  // namespace

std::size_t bootstrap_usable_size(const void* block) {
  std::size_t size = 0;
  memcpy(&size, static_cast<const char*>(block) - header_size, sizeof size);
  return size;
}

const Functions& resolve() {
  if (thread_state.resolving) return bootstrap_functions;
  thread_state.resolving = true;
  look_up(next_functions.malloc, "malloc");
  look_up(next_functions.calloc, "calloc");
  look_up(next_functions.realloc, "realloc");
  look_up(next_functions.free, "free");
  look_up(next_functions.posix_memalign, "posix_memalign");
  look_up(next_functions.aligned_alloc, "aligned_alloc");
  look_up(next_functions.memalign, "memalign");
  look_up(next_functions.valloc, "valloc");
  look_up(next_functions.pvalloc, "pvalloc");
  look_up(next_functions.malloc_usable_size, "malloc_usable_size");
  thread_state.resolving = false;
  next_ready.store(true, std::memory_order_release);
  return next_functions;
}

namespace {
// 101 is the first priority for applications: this runs before the constructors of this library's
// users.
[[gnu::constructor(101)]] void resolve_early() { next(); }
}  // namespace

}  // namespace agnocast::heaphook::libc_heap
