// SPDX-License-Identifier: Apache-2.0
//
// Stand-in for the heap hook: operator new of the test program, with an arena that plays the
// shared heap.
//
// Every allocation carries its origin in front of it, so an oracle can ask origin_of(pointer)
// without comparing addresses as the code under test does. Single-threaded. Link tagging_heap.cpp
// to get the operators.
#pragma once

#include <agnocast/residency.hpp>

#include <cstddef>
#include <cstdint>

namespace agnocast::test {

enum class Origin : std::uint64_t { libc = 0x6c69626331u, shared = 0x736861726564u };

/// Returns the origin of the allocation that starts at `first`; aborts if no live allocation
/// starts there.
Origin origin_of(const void* first);

/// Returns the arena as the library sees it.
SharedHeap shared_heap();
/// Returns the arena as one window, up to the highest allocation so far.
WindowSet windows();

struct HeapCounters {
  std::uint64_t allocations = 0;         ///< of either kind, since start
  std::uint64_t shared_allocations = 0;  ///< since start
  std::int64_t live = 0;                 ///< of either kind
};
HeapCounters heap_counters();

/// The n-th shared allocation from now on (1 = the next) comes from libc instead; 0 switches this
/// off. It does not count as spilled: the program behaves as if the scope had been closed for one
/// allocation.
void divert_shared_allocation(std::uint64_t n);
/// From now on the arena has room for `bytes` more; further allocations come from libc and count
/// as spilled.
void limit_shared_heap(std::size_t bytes);
void unlimit_shared_heap();

}  // namespace agnocast::test
