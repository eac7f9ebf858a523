// SPDX-License-Identifier: Apache-2.0
//
// The hook's state of the calling thread. Initial-exec TLS in zero-initialised static storage:
// reading it can neither allocate nor call the dynamic loader, so it is safe inside the very
// first malloc of a thread.
#pragma once

#include <cstdint>

namespace agnocast::heaphook {

struct ThreadState {
  std::uint32_t depth;    // open shared scopes (enter - leave)
  std::uint32_t blocked;  // > 0: libc only. Counts pause(), allocator calls, a fork in progress
  std::uint32_t bound;    // arena of the allocator for this thread's blocks; 0: not bound
  bool resolving;         // inside the look-up of the next malloc: use the bootstrap buffer
  bool forking;           // between our fork handlers: the allocator is locked, see fork.cpp
  bool handing_over;      // adding a window: extents stay closed, see shared_heap.cpp
  std::uint64_t spilled;  // allocations of this thread that found no room in the windows
  void (*no_room)();      // called by operator new if the windows have no room; null: libc serves
  void* deferred;         // shared blocks freed while forking, linked through their first word
};

inline constinit thread_local ThreadState thread_state [[gnu::tls_model("initial-exec")]] = {};

// While an object lives, every nested allocation of this thread comes from libc.
class LibcOnly {
 public:
  LibcOnly() { ++thread_state.blocked; }
  ~LibcOnly() { --thread_state.blocked; }
  LibcOnly(const LibcOnly&) = delete;
  LibcOnly& operator=(const LibcOnly&) = delete;
};

}  // namespace agnocast::heaphook
