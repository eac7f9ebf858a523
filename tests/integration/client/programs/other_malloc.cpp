// SPDX-License-Identifier: Apache-2.0
//
// Another allocator, preloaded in front of the heap hook, as tcmalloc or jemalloc would be. It
// scans every call to libc.

#include <cstddef>

extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* block, std::size_t size);
void __libc_free(void* block);

#define EXPORTED __attribute__((visibility("default")))
EXPORTED void* malloc(std::size_t size) { return __libc_malloc(size); }
EXPORTED void* calloc(std::size_t count, std::size_t size) { return __libc_calloc(count, size); }
EXPORTED void* realloc(void* block, std::size_t size) { return __libc_realloc(block, size); }
EXPORTED void free(void* block) { __libc_free(block); }
}
