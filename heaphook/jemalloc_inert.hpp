// SPDX-License-Identifier: Apache-2.0
//
// The used part of jemalloc's interface, under the names that jemalloc_inert.cmake gives it
// (prefix agnocast_je_), so that nothing of it is visible outside this library or clashes with
// another jemalloc in the process. Declared here instead of including jemalloc.h, whose macros
// rename malloc itself. Meanings: jemalloc(3), version 5.3.
#pragma once

#include <cstddef>

#include <sys/types.h>

extern "C" {

struct agnocast_je_extent_hooks {
  void* (*alloc)(agnocast_je_extent_hooks*, void* new_address, std::size_t size,
                 std::size_t alignment, bool* zero, bool* commit, unsigned arena);
  bool (*dalloc)(agnocast_je_extent_hooks*, void* address, std::size_t size, bool committed,
                 unsigned arena);
  void (*destroy)(agnocast_je_extent_hooks*, void* address, std::size_t size, bool committed,
                  unsigned arena);
  bool (*commit)(agnocast_je_extent_hooks*, void* address, std::size_t size, std::size_t offset,
                 std::size_t length, unsigned arena);
  bool (*decommit)(agnocast_je_extent_hooks*, void* address, std::size_t size, std::size_t offset,
                   std::size_t length, unsigned arena);
  bool (*purge_lazy)(agnocast_je_extent_hooks*, void* address, std::size_t size, std::size_t offset,
                     std::size_t length, unsigned arena);
  bool (*purge_forced)(agnocast_je_extent_hooks*, void* address, std::size_t size,
                       std::size_t offset, std::size_t length, unsigned arena);
  bool (*split)(agnocast_je_extent_hooks*, void* address, std::size_t size, std::size_t size_a,
                std::size_t size_b, bool committed, unsigned arena);
  bool (*merge)(agnocast_je_extent_hooks*, void* address_a, std::size_t size_a, void* address_b,
                std::size_t size_b, bool committed, unsigned arena);
};

// Argument of "experimental.arenas_create_ext": unlike "arenas.create" it lets an arena keep its
// metadata out of its extents.
struct agnocast_je_arena_config {
  agnocast_je_extent_hooks* extent_hooks;
  bool metadata_use_hooks;
};

void* agnocast_je_malloc(std::size_t size);
void* agnocast_je_calloc(std::size_t count, std::size_t size);
void* agnocast_je_memalign(std::size_t alignment, std::size_t size);
void* agnocast_je_mallocx(std::size_t size, int flags);
std::size_t agnocast_je_xallocx(void* block, std::size_t size, std::size_t extra, int flags);
void agnocast_je_free(void* block);
void agnocast_je_dallocx(void* block, int flags);
std::size_t agnocast_je_malloc_usable_size(const void* block);
int agnocast_je_mallctl(const char* name, void* old_value, std::size_t* old_size, void* new_value,
                        std::size_t new_size);

extern const char* agnocast_je_malloc_conf;
// Set to false before the first call: large blocks then start on a page and need no extra one, so
// a 1 MiB message takes 1 MiB of the window. 5.3.0 documents the option and has the variable, but
// does not accept it in its configuration string.
extern bool agnocast_je_internal_opt_cache_oblivious;

// Two internals of 5.3.0, for one purpose (shared_heap.cpp, never_without_threads): the table of
// arenas, and the increment of an arena's count of bound threads.
extern void* agnocast_je_internal_arenas[];
void agnocast_je_internal_arena_nthreads_inc(void* arena, bool internal);

extern void (*agnocast_je_malloc_message)(void* context, const char* text);

// Functions of libc that jemalloc would call, replaced in jemalloc_inert.cpp.
char* agnocast_je_secure_getenv(const char* name);
ssize_t agnocast_je_readlink(const char* path, char* buffer, std::size_t size);
double agnocast_je_exp(double);
double agnocast_je_log(double);
double agnocast_je_round(double);
int agnocast_je__Unwind_Backtrace(void*, void*);
std::size_t agnocast_je__Unwind_GetIP(void*);
}
