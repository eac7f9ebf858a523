// SPDX-License-Identifier: Apache-2.0
//
// Shared heap: an allocator whose memory is the windows (windows.hpp).
//
// The allocator is jemalloc, made inert (jemalloc_inert.cmake): it runs no constructor, reads no
// configuration and starts at attach. Its arena number 0 is in private memory and keeps all
// metadata; the *shared arena* takes its extents from the windows through our hooks and holds
// payload only. So a reader that maps the window sees messages and no metadata of the allocator.
//
//     malloc → thread cache → slab or extent of the shared arena → windows::open(): map, announce
//
// A FRESH window starts another shared arena, and all threads allocate from that one only.
// Earlier arenas keep their blocks until they are freed, bypassing all thread caches, and
// allocate nothing any more.
//
// Freed extents stay with the arena, resident and warm, until purge() punches them; nothing else
// returns pages. idle() returns how much of that memory is not needed.
//
// Locks: the arena's own, then the growth lock of windows.cpp; never the other way round. A
// thread inside the allocator has ThreadState::blocked > 0, so nested allocations of the
// allocator (pthread_setspecific may call calloc) come from libc.
#pragma once

#include "windows.hpp"

#include <agnocast/abi/heaphook.h>

#include <cstddef>
#include <cstdint>

namespace agnocast::heaphook::shared_heap {

// Return null if the windows have no room; the caller then takes libc's memory. Alignments are
// powers of two. Only for the owner of the windows (windows::is_owner).
void* allocate(std::size_t size);
void* allocate_zeroed(std::size_t size);
void* allocate_aligned(std::size_t alignment, std::size_t size);
// Keeps the old block and returns null if the windows have no room.
void* reallocate(void* block, std::size_t size);
// Any thread, any process. Does nothing in a forked child: the block belongs to the parent.
// `window` contains the block.
void release(void* block, const windows::Window& window);
// Any thread, any process.
std::size_t usable_size(const void* block);

enum agnocast_heaphook_status attach(const struct agnocast_heaphook_window& window,
                                     const struct agnocast_heaphook_options& options);
enum agnocast_heaphook_status add_window(const struct agnocast_heaphook_window& window);
// Returns the number of the oldest window that blocks come from.
std::uint32_t first_window();
void usage(struct agnocast_heaphook_usage& usage);
std::uint64_t purge();
std::uint64_t idle();

// Counts an event that should be impossible; never fatal.
void note_internal_error();

}  // namespace agnocast::heaphook::shared_heap
