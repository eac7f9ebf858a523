// SPDX-License-Identifier: Apache-2.0

#include "tests/support/memory/tagging_heap.hpp"

#include <sys/mman.h>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <new>

namespace agnocast::test {
namespace {

// 8 GiB of addresses, never reused, so that a stale pointer is never resident by accident; pages
// only where touched.
constexpr std::size_t arena_bytes = std::size_t{8} << 30;
constexpr std::size_t no_limit = std::numeric_limits<std::size_t>::max();

struct alignas(16) Header {
  Origin origin;
  void* block;  // libc's pointer; null in the arena
};

struct Heap {
  std::uintptr_t arena = 0;
  std::size_t used = 0;
  std::size_t limit = no_limit;
  std::uint64_t depth = 0;
  std::uint64_t spilled = 0;
  std::uint64_t divert = 0;
  HeapCounters counters;
};
constinit Heap heap;

Header* header_of(void* first) { return static_cast<Header*>(first) - 1; }

void* place(std::uintptr_t address, Origin origin, void* block) {
  void* first = reinterpret_cast<void*>(address);
  *header_of(first) = {origin, block};
  return first;
}

std::uintptr_t round_up(std::uintptr_t value, std::size_t alignment) {
  return (value + alignment - 1) & ~(alignment - 1);
}

bool wants_shared() {
  if (heap.depth == 0) return false;
  return heap.divert == 0 || --heap.divert != 0;
}

void* allocate(std::size_t bytes, std::size_t alignment) {
  if (alignment < sizeof(Header)) alignment = sizeof(Header);
  ++heap.counters.allocations;
  if (wants_shared()) {
    if (heap.arena == 0) {
      void* memory = mmap(nullptr, arena_bytes, PROT_READ | PROT_WRITE,
                          MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
      if (memory == MAP_FAILED) std::abort();
      heap.arena = reinterpret_cast<std::uintptr_t>(memory);
    }
    const std::uintptr_t first = round_up(heap.arena + heap.used + sizeof(Header), alignment);
    const std::size_t used = first + bytes - heap.arena;
    if (used <= arena_bytes && used <= heap.limit) {
      heap.used = used;
      ++heap.counters.shared_allocations;
      ++heap.counters.live;
      return place(first, Origin::shared, nullptr);
    }
    ++heap.spilled;
  }
  void* block = std::malloc(bytes + sizeof(Header) + alignment);
  if (block == nullptr) throw std::bad_alloc();
  ++heap.counters.live;
  return place(round_up(reinterpret_cast<std::uintptr_t>(block) + sizeof(Header), alignment),
               Origin::libc, block);
}

void release(void* first) {
  if (first == nullptr) return;
  Header* header = header_of(first);
  if (header->origin != Origin::libc && header->origin != Origin::shared) {
    std::fputs("tagging_heap: delete of something that new did not make\n", stderr);
    std::abort();
  }
  void* block = header->block;
  const bool is_libc = header->origin == Origin::libc;
  header->origin = Origin{};
  --heap.counters.live;
  if (is_libc) std::free(block);
}

}  // namespace

Origin origin_of(const void* first) {
  const Origin origin = (static_cast<const Header*>(first) - 1)->origin;
  if (origin != Origin::libc && origin != Origin::shared) {
    std::fputs("tagging_heap: nothing is allocated there\n", stderr);
    std::abort();
  }
  return origin;
}

WindowSet windows() {
  WindowSet set;
  set.add(heap.arena, heap.arena + heap.used);
  return set;
}

SharedHeap shared_heap() {
  SharedHeap steering;
  steering.enter = [](void*) noexcept {
    ++heap.depth;
    return heap.spilled;
  };
  steering.leave = [](void*) noexcept {
    --heap.depth;
    return heap.spilled;
  };
  steering.windows = [](void*) noexcept { return windows(); };
  return steering;
}

HeapCounters heap_counters() { return heap.counters; }
void divert_shared_allocation(std::uint64_t n) { heap.divert = n; }
void limit_shared_heap(std::size_t bytes) { heap.limit = heap.used + bytes; }
void unlimit_shared_heap() { heap.limit = no_limit; }

}  // namespace agnocast::test

using agnocast::test::allocate;
using agnocast::test::release;

void* operator new(std::size_t bytes) { return allocate(bytes, 1); }
void* operator new[](std::size_t bytes) { return allocate(bytes, 1); }
void* operator new(std::size_t bytes, std::align_val_t alignment) {
  return allocate(bytes, static_cast<std::size_t>(alignment));
}
void* operator new[](std::size_t bytes, std::align_val_t alignment) {
  return allocate(bytes, static_cast<std::size_t>(alignment));
}
void operator delete(void* first) noexcept { release(first); }
void operator delete[](void* first) noexcept { release(first); }
void operator delete(void* first, std::size_t) noexcept { release(first); }
void operator delete[](void* first, std::size_t) noexcept { release(first); }
void operator delete(void* first, std::align_val_t) noexcept { release(first); }
void operator delete[](void* first, std::align_val_t) noexcept { release(first); }
void operator delete(void* first, std::size_t, std::align_val_t) noexcept { release(first); }
void operator delete[](void* first, std::size_t, std::align_val_t) noexcept { release(first); }
