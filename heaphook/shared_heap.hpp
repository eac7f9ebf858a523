// SPDX-License-Identifier: Apache-2.0
//
// Shared heap: the allocator whose memory is the windows (windows.hpp).
//
// The allocator is jemalloc, made inert (jemalloc_inert.cmake): it runs no constructor, reads no configuration and starts
// at attach. Its arena number 0 lives in private memory and keeps all metadata; the *shared arena* takes its extents from the
// windows through our hooks and holds payload only. So nothing that decides where memory goes is ever visible outside the
// process, and a reader that maps the window sees messages and nothing else.
//
//     malloc → thread cache → slab or extent of the shared arena → windows::open(): map further, tell the client
//
// A FRESH window starts another shared arena, and all threads take from that one only. The arenas before it keep their blocks until
// they are freed, past every thread cache, and hand out nothing any more.
//
// Freed extents stay with the arena, resident and warm, until purge() punches them; nothing else gives pages back. How much of that
// nobody wants is told by idle().
//
// Locks: the arena's own, then the growth lock of windows.cpp; never the other way round. A thread inside the allocator has
// ThreadState::blocked > 0, so whatever the allocator calls (pthread_setspecific may call calloc) is served by libc.
#pragma once

#include "windows.hpp"

#include <agnocast/abi/heaphook.h>

#include <cstddef>
#include <cstdint>

namespace agnocast::heaphook::shared_heap {

// Null when the windows have no room; the caller then takes libc's memory. Alignments are powers of two. For the owner of
// the windows only (windows::is_owner).
void* allocate(std::size_t size);
void* allocate_zeroed(std::size_t size);
void* allocate_aligned(std::size_t alignment, std::size_t size);
// Keeps the old block and answers null when the windows have no room.
void* reallocate(void* block, std::size_t size);
// Any thread, any process. In a forked child nothing happens: the block is the parent's. The window is the block's.
void release(void* block, const windows::Window& window);
// Any thread, any process.
std::size_t usable_size(const void* block);

enum agnocast_heaphook_status attach(const struct agnocast_heaphook_window& window,
                                     const struct agnocast_heaphook_options& options);
enum agnocast_heaphook_status add_window(const struct agnocast_heaphook_window& window);
// The oldest window that blocks come from.
std::uint32_t first_window();
void usage(struct agnocast_heaphook_usage& usage);
bool wants_window();
std::uint64_t purge();
std::uint64_t idle();

// Something that cannot happen did: counted, never fatal.
void note_internal_error();

}  // namespace agnocast::heaphook::shared_heap
