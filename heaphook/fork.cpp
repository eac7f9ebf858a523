// SPDX-License-Identifier: Apache-2.0
//
// Rights of a forked child on the parent's messages: it may read them, and change its own copy.
//
//                        parent                              child
//   memory of a window   MAP_SHARED, MADV_DONTFORK           MAP_PRIVATE of the read-only descriptor,
//                                                            up to the frontier
//   owner word           1                                   0 (MADV_WIPEONFORK), at once
//   malloc in a scope    shared arena                        libc
//   free(shared)         to the arena                        nothing
//   realloc(shared)      in the arena, else copied to libc   copied to libc
//
// Three pairs of handlers run at fork. pthread_atfork calls `prepare` handlers
// last-registered-first and the others first-registered-first, so registering inner, allocator,
// outer gives
//
//   prepare:        outer: this thread is `forking`  →  jemalloc locks its arenas  →  inner: lock growth
//   parent, child:  inner: unlock growth (child: map the private view)  →  jemalloc unlocks  →  outer: done forking
//
// While `forking`, handlers of other libraries may run with the allocator locked: their
// allocations go to libc. Shared blocks that they free are put into a list, which the parent
// frees afterwards and the child discards.
//
// vfork, posix_spawn and exec never get here: they run on the parent's memory for an instant and
// leave. A child made by _Fork or a raw clone gets no handlers: it is no owner (owner word), and
// has no windows at all (MADV_DONTFORK) – touching a message there faults, which is better than
// writing into the parent's memory.

#include "fork.hpp"

#include "shared_heap.hpp"
#include "thread_state.hpp"
#include "windows.hpp"

#include <pthread.h>

namespace agnocast::heaphook::fork_rules {
namespace {

// Whether the forking process owns the windows: a grandchild inherits ordinary private memory and
// needs no view. Guarded by the growth lock, which is held from inner_prepare to inner_parent or
// inner_child.
constinit bool forks_from_owner = false;

void inner_prepare() {
  windows::lock_growth();
  forks_from_owner = windows::is_owner();
}

void inner_parent() { windows::unlock_growth(); }

void inner_child() {
  if (forks_from_owner) windows::map_private_view();
  forks_from_owner = false;
  windows::unlock_growth();
}

void outer_prepare() {
  ++thread_state.blocked;
  thread_state.forking = true;
}

void outer_parent() {
  thread_state.forking = false;
  --thread_state.blocked;
  while (void* const block = thread_state.deferred) {
    thread_state.deferred = *static_cast<void**>(block);
    shared_heap::release(block, *windows::window_of(block));
  }
}

void outer_child() {
  thread_state.forking = false;
  --thread_state.blocked;
  thread_state.deferred = nullptr;
}

}  // namespace

bool register_inner() { return pthread_atfork(inner_prepare, inner_parent, inner_child) == 0; }
bool register_outer() { return pthread_atfork(outer_prepare, outer_parent, outer_child) == 0; }

}  // namespace agnocast::heaphook::fork_rules
