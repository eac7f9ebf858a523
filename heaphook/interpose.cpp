// SPDX-License-Identifier: Apache-2.0
//
// The interposed malloc family of the process: each function forwards to route.hpp and does
// nothing else.
//
// The declarations are our own: libc's headers have attributes (malloc, nonnull) from which the
// compiler may conclude facts that hold for callers but not for the implementation.

#include "route.hpp"

#define AGNOCAST_INTERPOSED __attribute__((visibility("default")))

namespace route = agnocast::heaphook::route;
namespace libc_heap = agnocast::heaphook::libc_heap;

extern "C" {

AGNOCAST_INTERPOSED void* malloc(std::size_t size) { return route::allocate(size); }
AGNOCAST_INTERPOSED void* calloc(std::size_t count, std::size_t size) {
  return route::allocate_zeroed(count, size);
}
AGNOCAST_INTERPOSED void* realloc(void* block, std::size_t size) {
  return route::reallocate(block, size);
}
AGNOCAST_INTERPOSED void* reallocarray(void* block, std::size_t count, std::size_t size) {
  return route::reallocate_array(block, count, size);
}
AGNOCAST_INTERPOSED void free(void* block) { route::release(block); }

AGNOCAST_INTERPOSED int posix_memalign(void** result, std::size_t alignment, std::size_t size) {
  return route::allocate_posix(result, alignment, size);
}
AGNOCAST_INTERPOSED void* aligned_alloc(std::size_t alignment, std::size_t size) {
  return route::allocate_aligned(alignment, size, libc_heap::next().aligned_alloc);
}
AGNOCAST_INTERPOSED void* memalign(std::size_t alignment, std::size_t size) {
  return route::allocate_aligned(alignment, size, libc_heap::next().memalign);
}
AGNOCAST_INTERPOSED void* valloc(std::size_t size) { return route::allocate_pages(size); }
AGNOCAST_INTERPOSED void* pvalloc(std::size_t size) { return route::allocate_whole_pages(size); }
AGNOCAST_INTERPOSED std::size_t malloc_usable_size(void* block) {
  return route::usable_size(block);
}

// C23; programs built on a newer libc call them. Neither heap needs the size.
AGNOCAST_INTERPOSED void free_sized(void* block, std::size_t) { route::release(block); }
AGNOCAST_INTERPOSED void free_aligned_sized(void* block, std::size_t, std::size_t) {
  route::release(block);
}
}
