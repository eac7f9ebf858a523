// SPDX-License-Identifier: Apache-2.0
//
// What the hook knows about the calling thread. Initial-exec TLS in zero-initialised static storage: reading it can neither
// allocate nor call the dynamic loader, so it is safe inside the very first malloc of a thread.
#pragma once

#include <cstdint>

namespace agnocast::heaphook {

struct ThreadState {
  std::uint32_t depth;     // open shared scopes (enter - leave)
  std::uint32_t blocked;   // > 0: libc only. Counts pause(), calls into the allocator, and a fork in progress
  std::uint32_t bound;     // arena that the allocator takes this thread's blocks from; 0: not told yet
  bool resolving;          // inside the look-up of the next malloc: serve from the bootstrap buffer
  bool forking;            // between our fork handlers: the allocator's locks are held, see fork.cpp
  bool handing_over;       // adding a window: extents are passed on and not opened, see shared_heap.cpp
  std::uint64_t spilled;   // attempts of this thread to allocate from the windows that found no room
  void (*no_room)();       // what operator new calls where the windows have none; null: libc serves
  void* deferred;          // shared blocks freed while forking, linked through their first word
};

inline constinit thread_local ThreadState thread_state [[gnu::tls_model("initial-exec")]] = {};

// While one of these lives, every nested allocation of this thread is libc's.
class LibcOnly {
 public:
  LibcOnly() { ++thread_state.blocked; }
  ~LibcOnly() { --thread_state.blocked; }
  LibcOnly(const LibcOnly&) = delete;
  LibcOnly& operator=(const LibcOnly&) = delete;
};

}  // namespace agnocast::heaphook
