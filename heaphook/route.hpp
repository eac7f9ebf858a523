// SPDX-License-Identifier: Apache-2.0
//
// Route: the decision of the hook between shared heap and libc.
//
//   allocate          by the calling thread's scope; if the windows have no room, from libc
//   free, usable_size by address, in any thread
//   realloc           a shared block stays shared in any scope (it belongs to a message); a libc
//                     block moves into the windows if the thread is in scope; if that is
//                     impossible, the content is copied to libc
//
// Every request that the windows cannot serve goes to libc, also invalid ones, so return values
// and errno are libc's own. The hook adds no failures of its own.
#pragma once

#include "libc_heap.hpp"
#include "shared_heap.hpp"
#include "thread_state.hpp"
#include "windows.hpp"

#include <atomic>
#include <cstddef>

namespace agnocast::heaphook::route {

extern constinit std::atomic<bool> scope_all;

// Returns whether the calling thread's next allocation tries the windows.
inline bool wants_shared() {
  const ThreadState& thread = thread_state;
  if (thread.depth == 0 && !scope_all.load(std::memory_order_relaxed)) [[likely]]
    return false;
  return thread.blocked == 0 && windows::is_owner();
}

// The shared part of an allocation, also for operator new: null means "call the next definition".
inline void* try_shared(std::size_t size) {
  return wants_shared() ? shared_heap::allocate(size) : nullptr;
}
void* try_shared_aligned(std::size_t alignment, std::size_t size);
// For new: whether the thread has forbidden libc's memory where the windows have no room.
inline bool is_refused() { return thread_state.no_room != nullptr && wants_shared(); }
void say_no_room();
inline void* try_shared_or_throw(std::size_t size) {
  if (!wants_shared()) return nullptr;
  void* const block = shared_heap::allocate(size);
  if (block == nullptr) [[unlikely]]
    say_no_room();
  return block;
}
inline void* try_shared_aligned_or_throw(std::size_t alignment, std::size_t size) {
  void* const block = try_shared_aligned(alignment, size);
  if (block == nullptr && wants_shared()) [[unlikely]]
    say_no_room();
  return block;
}

inline void* allocate(std::size_t size) {
  if (void* const block = try_shared(size)) return block;
  return libc_heap::next().malloc(size);
}
void* allocate_zeroed(std::size_t count, std::size_t size);
void* reallocate(void* block, std::size_t size);
void* reallocate_array(void* block, std::size_t count, std::size_t size);
int allocate_posix(void** result, std::size_t alignment, std::size_t size);
// `next` is the corresponding libc function: aligned_alloc or memalign.
void* allocate_aligned(std::size_t alignment, std::size_t size,
                       void* (*next)(std::size_t, std::size_t));
void* allocate_pages(std::size_t size);
void* allocate_whole_pages(std::size_t size);
inline void release(void* block) {
  if (const windows::Window* const window = windows::window_of(block)) [[unlikely]] {
    shared_heap::release(block, *window);
  } else if (!libc_heap::from_bootstrap(block)) [[likely]] {
    libc_heap::next().free(block);
  }
}
std::size_t usable_size(void* block);

}  // namespace agnocast::heaphook::route
