// SPDX-License-Identifier: Apache-2.0
//
// Windows: the shared memory itself. Records its addresses, its mapped part, and the process that
// may write it. The allocator over them is the hook's (shared_heap.hpp) or, in a process without
// the hook, that of libagnocast (client/heap/block_heap.hpp).
//
//      base                          used          frontier                          base + length
//       |  opened for the shared arena |  mapped     |  not mapped: nothing, or the caller's PROT_NONE  |
//       |<------ MAP_SHARED, MADV_DONTFORK --------->|
//
// The arena has all addresses of a window from the start and takes the lowest that fit; `used` is
// the end of the part that it ever opened, `frontier` runs ahead of that in steps. Both only
// grow. Pages beyond the frontier cost nothing: no memory under mlockall, no part of
// RLIMIT_MEMLOCK (unless reserved).
//
// Memory is opened by mapping the next piece of the memfd, not by mprotect of one large mapping:
// mlockall and RLIMIT_MEMLOCK count the addresses of a mapping even if it is PROT_NONE. The
// kernel merges adjacent pieces to one mapping.
#pragma once

#include <agnocast/abi/heaphook.h>

#include <atomic>
#include <cstddef>
#include <cstdint>

namespace agnocast::heaphook::windows {

// base, length, descriptors and identity are set before the window counts and never change; used
// <= frontier <= length.
struct alignas(64) Window {
  std::uintptr_t base;
  std::size_t length;
  std::atomic<std::size_t> used;
  std::atomic<std::size_t> frontier;
  int write_fd;  // our duplicates, close-on-exec
  int read_fd;
  std::uint64_t device;  // identity of the memfd: a program may close our numbers and reuse them
  std::uint64_t inode;
  bool reserved;
  // Guarded by the growth lock: a bit for each page of 4 KiB that was in use and is closed.
  std::uint64_t* closed;
  std::size_t closed_bytes;
  std::size_t stuck_bytes;  // regrown bytes that remained after the last punch_unused()
};

extern constinit Window table[AGNOCAST_HEAPHOOK_WINDOWS_MAX];
// [sync:window] stored with release after the window's fields; window_of() loads it with acquire.
extern constinit std::atomic<std::uint32_t> count;

// 1 in the process that attached, 0 before and in every child of it, however it was forked: after
// attach the word is in a page that the kernel wipes at fork (MADV_WIPEONFORK). Points to a
// constant 0 while inert.
extern constinit std::atomic<const std::atomic<std::uint32_t>*> owner_word;
inline bool is_owner() {
  return owner_word.load(std::memory_order_acquire)->load(std::memory_order_relaxed) != 0;
}

// Returns the window of an address, mapped or not; null for all other memory. The loop is empty
// while inert.
inline const Window* window_of(const void* address) {
  const std::uint32_t window_count = count.load(std::memory_order_acquire);
  for (std::uint32_t i = 0; i < window_count; ++i) {
    if (reinterpret_cast<std::uintptr_t>(address) - table[i].base < table[i].length)
      return &table[i];
  }
  return nullptr;
}

inline std::uint32_t number_of(const Window& window) {
  return static_cast<std::uint32_t>(&window - table);
}

inline bool is_mapped(const Window& window, const void* address) {
  return reinterpret_cast<std::uintptr_t>(address) - window.base <
         window.frontier.load(std::memory_order_acquire);
}

// Makes this process the owner. Returns false with errno if the kernel refuses.
bool become_owner();

// Adds a window: checks it, keeps duplicates of its descriptors, opens its first piece, announces
// the frontier. Leaves nothing behind on refusal.
enum agnocast_heaphook_status add(const struct agnocast_heaphook_window& window);
// Undoes the add() of the only window, for an attach that fails later.
void remove_first();

void set_grown(agnocast_heaphook_grown grown, void* context);

// Opens part of a window for use: maps and announces it. Returns false if the system refuses.
bool open(void* address, std::size_t length);

// Returns pages to the kernel until open() is called for them; they read as zero from now on. Skips
// those that it has returned before. Returns false if the kernel refuses.
bool shut(void* address, std::size_t length);

// A reader that touches a hole through its mapping allocates a page that no message uses. Returns
// about how many bytes such pages have, without those that punch_unused() could not remove.
std::uint64_t grown_back();
// Punches all unused memory up to the frontier, if such pages have appeared.
void punch_unused();

// Returns how many bytes of the part in use are closed.
std::uint64_t closed_bytes();

// Counts a request that found no room.
void count_refused(std::size_t size);
// Returns whether another window is allowed, and needed soon.
bool wants_another();
// Fills in what is known of the windows, and leaves the rest.
void add_usage(struct agnocast_heaphook_usage& usage);

// Counters of agnocast_heaphook_usage that belong to the windows.
struct Counters {
  std::atomic<std::uint64_t> refused_count;
  std::atomic<std::uint64_t> refused_bytes_max;
  std::atomic<std::uint64_t> mapping_refused_count;
  std::atomic<std::uint64_t> punch_count;
  std::atomic<std::uint64_t> punched_bytes;
};
extern constinit Counters counters;

// For fork handlers.
void lock_growth();
void unlock_growth();
// In the child: maps a private copy-on-write view of every window, where MADV_DONTFORK left a
// hole.
void map_private_view();

}  // namespace agnocast::heaphook::windows
