// SPDX-License-Identifier: Apache-2.0
//
// The shared arena: jemalloc with our extent hooks. See shared_heap.hpp.

#include "shared_heap.hpp"

#include "fork.hpp"
#include "jemalloc_inert.hpp"
#include "thread_state.hpp"
#include "windows.hpp"

#include <errno.h>
#include <string.h>
#include <sys/auxv.h>
#include <sys/mman.h>

#include <atomic>

namespace agnocast::heaphook::shared_heap {
namespace {

enum class State : std::uint32_t { inert, attaching, attached, broken };
constinit std::atomic<State> state{State::inert};

// Arenas of the windows, oldest first; attach and add_window have one caller at a time.
constinit unsigned arenas[AGNOCAST_HEAPHOOK_WINDOWS_MAX] = {};
// [sync:fresh] The arena that blocks come from, and above it the number of its first window: one
// word, stored with release, so that a thread with a block of a fresh window also sees the
// earlier windows closed for allocation. arena_count is stored first.
constinit std::atomic<std::uint64_t> current{0};
constinit std::atomic<std::uint32_t> arena_count{0};
constexpr std::uint64_t packed(std::uint32_t window, unsigned arena) {
  return std::uint64_t{window} << 32 | arena;
}
constexpr unsigned arena_of(std::uint64_t word) { return static_cast<unsigned>(word); }
constexpr std::uint32_t first_of(std::uint64_t word) {
  return static_cast<std::uint32_t>(word >> 32);
}
// Windows before this one only take blocks back.
bool is_given_up(const windows::Window& window) {
  return windows::number_of(window) < first_of(current.load(std::memory_order_acquire));
}

constinit std::atomic<std::uint32_t> purging{0};  // calls of purge() in progress

// Blocks of this size and more are counted while they live: the maximum of their bytes since the
// last idle() is the demand. They are few, and begin on a page, so their address tells them from
// small blocks at free.
constexpr std::size_t counted_min = std::size_t{64} << 10;
constexpr std::size_t page_min = 4096;
constinit std::atomic<std::uint64_t> counted_bytes{0};
constinit std::atomic<std::uint64_t> counted_bytes_max{0};  // since the last idle()

// Returns whether asking the allocator for the size is worthwhile.
bool may_be_counted(const void* block) {
  return reinterpret_cast<std::uintptr_t>(block) % page_min == 0 &&
         counted_bytes.load(std::memory_order_relaxed) != 0;
}

void count_block(std::size_t before, std::size_t after) {
  if (before < counted_min) before = 0;
  if (after < counted_min) after = 0;
  if (before == after) return;
  const std::uint64_t now =
      counted_bytes.fetch_add(after - before, std::memory_order_relaxed) + after - before;
  std::uint64_t seen = counted_bytes_max.load(std::memory_order_relaxed);
  while (now > seen &&
         !counted_bytes_max.compare_exchange_weak(seen, now, std::memory_order_relaxed)) {
  }
}

constinit std::atomic<std::uint64_t> internal_error_count{0};

constexpr int no_cache = 1 << 8;  // MALLOCX_TCACHE_NONE

// The address that hand_over() passes on; attach and add_window have one caller at a time.
constinit std::uintptr_t handed_address = 0;

// The arena gets addresses only from hand_over(), which requests exactly the size that it passes
// on.
void* extent_alloc(agnocast_je_extent_hooks*, void* new_address, std::size_t, std::size_t,
                   bool* zero, bool* commit, unsigned) {
  if (!thread_state.handing_over || new_address != nullptr || handed_address == 0) return nullptr;
  void* const extent = reinterpret_cast<void*>(handed_address);
  handed_address = 0;
  *zero = true;     // the memfd reads as zero
  *commit = false;  // nothing is open yet: the arena calls extent_commit for the part that it uses
  return extent;
}

bool extent_commit(agnocast_je_extent_hooks*, void* address, std::size_t, std::size_t offset,
                   std::size_t length, unsigned) {
  return thread_state.handing_over || !windows::open(static_cast<char*>(address) + offset, length);
}

// A refusal makes the arena keep the extent for later use.
bool extent_dalloc(agnocast_je_extent_hooks*, void*, std::size_t, bool, unsigned) { return true; }

// Closes an idle extent, so that the arena calls extent_commit before it uses it again.
bool extent_decommit(agnocast_je_extent_hooks*, void* address, std::size_t, std::size_t offset,
                     std::size_t length, unsigned) {
  if (purging.load(std::memory_order_relaxed) == 0) {
    note_internal_error();
    return true;
  }
  return !windows::shut(static_cast<char*>(address) + offset, length);
}

// Extents are only addresses here, so any part of a window can be split and any two neighbours
// joined. Neighbours in different windows must stay apart: they belong to different files.
bool extent_split(agnocast_je_extent_hooks*, void*, std::size_t, std::size_t, std::size_t, bool,
                  unsigned) {
  return false;
}
bool extent_merge(agnocast_je_extent_hooks*, void* a, std::size_t, void* b, std::size_t, bool,
                  unsigned) {
  return windows::window_of(a) != windows::window_of(b);
}

constinit agnocast_je_extent_hooks extent_hooks = {
    .alloc = extent_alloc,
    .dalloc = extent_dalloc,
    .destroy = nullptr,
    .commit = extent_commit,
    .decommit = extent_decommit,
    .purge_lazy = nullptr,
    .purge_forced = nullptr,
    .split = extent_split,
    .merge = extent_merge,
};

void no_message(void*, const char*) { note_internal_error(); }

template <typename T>
bool get(const char* name, T& value) {
  std::size_t size = sizeof value;
  return agnocast_je_mallctl(name, &value, &size, nullptr, 0) == 0;
}

template <typename T>
bool set(const char* name, T value) {
  return agnocast_je_mallctl(name, nullptr, nullptr, &value, sizeof value) == 0;
}

// Builds "arena.1.purge" and the like. Arena numbers are small: narenas:1 makes our first number
// 1.
struct ArenaName {
  char text[64];
  ArenaName(const char* before, unsigned arena, const char* after) {
    append(append(text, before), arena, after);
  }
  // "stats.arenas.1.bins.12.nslabs"
  ArenaName(const char* before, unsigned arena, const char* middle, unsigned index,
            const char* after) {
    append(append(append(text, before), arena, middle), index, after);
  }

 private:
  static char* append(char* out, const char* word) { return stpcpy(out, word); }
  static char* append(char* out, unsigned number, const char* after) {
    char digits[12];
    int count = 0;
    do {
      digits[count++] = static_cast<char>('0' + number % 10);
      number /= 10;
    } while (number != 0);
    while (count > 0) *out++ = digits[--count];
    return append(out, after);
  }
};

// Binds this thread to the shared arena for allocations; a thread that only frees needs no
// binding.
void bind_thread() {
  const std::uint64_t now = current.load(std::memory_order_acquire);
  if (thread_state.bound == arena_of(now)) [[likely]]
    return;
  // Returns cached free blocks of earlier windows to those, not to the next caller.
  if (first_of(now) != 0) agnocast_je_mallctl("thread.tcache.flush", nullptr, nullptr, nullptr, 0);
  // If unbound (out of memory), this allocation comes from libc, and the next one tries again.
  thread_state.bound = set("thread.arena", arena_of(now)) ? arena_of(now) : 0;
}

// The allocator's cleanup removes the binding of an ending thread; later destructors of thread
// data would get private memory of arena 0. A thread whose rebinding failed would get memory of
// an earlier window. Such blocks are freed again, and libc serves the request.
void* if_in_window(void* block) {
  if (block == nullptr) return nullptr;
  const windows::Window* const window = windows::window_of(block);
  if (window != nullptr && !is_given_up(*window)) [[likely]]
    return block;
  agnocast_je_free(block);
  return nullptr;
}

// libc aligns every block to 16 bytes and compilers rely on it; the allocator's 8-byte class
// would not.
constexpr std::size_t size_min = 16;
constexpr std::size_t at_least_min(std::size_t size) { return size < size_min ? size_min : size; }

[[gnu::noinline, gnu::cold]] void count_made(void* block) { count_block(0, usable_size(block)); }

void* or_refused(void* block, std::size_t size) {
  if (block != nullptr) [[likely]] {
    // A size class is less than twice the requested size.
    if (size >= counted_min / 2) [[unlikely]]
      count_made(block);
    return block;
  }
  ++thread_state.spilled;
  // Idle memory is unavailable while purge() returns it, and available again afterwards: the heap
  // is not full, and needs no further window.
  if (purging.load(std::memory_order_relaxed) != 0) return nullptr;
  windows::count_refused(size);
  return nullptr;
}

// Restores errno: the allocator sets it, although libc is called next and may succeed.
class KeepErrno {
 public:
  KeepErrno() : place_(&errno), value_(*place_) {}
  ~KeepErrno() { *place_ = value_; }
  KeepErrno(const KeepErrno&) = delete;
  KeepErrno& operator=(const KeepErrno&) = delete;

 private:
  int* place_;
  int value_;
};

// Returns whether `size` more bytes of private memory may be mapped: a PROT_NONE mapping uses no
// memory, but counts as locked and against RLIMIT_AS.
enum agnocast_heaphook_status room_for(std::size_t size) {
  void* const probe =
      mmap(nullptr, size, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (probe == MAP_FAILED)
    return errno == EAGAIN ? AGNOCAST_HEAPHOOK_LOCK_LIMIT : AGNOCAST_HEAPHOOK_OS;
  munmap(probe, size);
  return AGNOCAST_HEAPHOOK_OK;
}

// Private addresses of one more arena: 2 MiB of its own and the needs of its first blocks.
constexpr std::size_t arena_bytes = std::size_t{8} << 20;

// The allocator counts thread caches as allocated. Threads that only free are not bound and count
// with arena 0, whose own blocks are never cached.
std::uint64_t live_bytes() {
  std::size_t allocated = 0;
  std::size_t cached = 0;
  bool known = set("epoch", std::uint64_t{1}) && get("stats.arenas.0.tcache_bytes", cached);
  for (std::uint32_t i = 0; known && i < arena_count.load(std::memory_order_acquire); ++i) {
    std::size_t small = 0;
    std::size_t large = 0;
    std::size_t in_caches = 0;
    known = get(ArenaName("stats.arenas.", arenas[i], ".small.allocated").text, small) &&
            get(ArenaName("stats.arenas.", arenas[i], ".large.allocated").text, large) &&
            get(ArenaName("stats.arenas.", arenas[i], ".tcache_bytes").text, in_caches);
    allocated += small + large;
    cached += in_caches;
  }
  if (!known) {
    note_internal_error();
    return 0;
  }
  return cached < allocated ? allocated - cached : 0;
}

// When the last thread bound to an arena ends, jemalloc returns all idle pages of the arena, in
// that thread. Ours must keep them until purge(), so this increments the arena's thread count by
// one.
bool never_without_threads(unsigned number) {
  void* const arena = __atomic_load_n(&agnocast_je_internal_arenas[number], __ATOMIC_ACQUIRE);
  if (arena == nullptr) return false;
  agnocast_je_internal_arena_nthreads_inc(arena, false);
  unsigned thread_count = 0;
  return set("epoch", std::uint64_t{1}) &&
         get(ArenaName("stats.arenas.", number, ".nthreads").text, thread_count) &&
         thread_count == 1;
}

void start_allocator() {
  agnocast_je_malloc_message = no_message;
  agnocast_je_internal_opt_cache_oblivious = false;
}

// Makes a shared arena without addresses; returns 0 if there is no memory for it.
unsigned make_arena() {
  agnocast_je_arena_config config = {.extent_hooks = &extent_hooks, .metadata_use_hooks = false};
  unsigned arena = 0;
  std::size_t size = sizeof arena;
  if (agnocast_je_mallctl("experimental.arenas_create_ext", &arena, &size, &config,
                          sizeof config) != 0)
    return 0;
  return never_without_threads(arena) ? arena : 0;
}

// Passes the addresses of a window to the arena, closed. jemalloc never joins extents from
// separate calls, so passing memory piece by piece would leave a window of pieces too small for a
// large message. Instead it requests one block of the whole size: the arena calls extent_alloc,
// gets the window, calls extent_commit to open it, is refused, keeps the addresses as a closed
// extent and returns null. Sizes are its size classes, four per doubling; most windows are one.
bool hand_over(const windows::Window& window, unsigned arena) {
  const int flags = static_cast<int>((arena + 1) << 20) | no_cache;
  thread_state.handing_over = true;
  bool taken = true;
  std::size_t offset = 0;
  while (taken && offset < window.length) {
    const std::size_t left = window.length - offset;
    const std::size_t class_distance =
        std::size_t{1} << (61 - __builtin_clzl(left));  // a quarter of the next lower power of two
    const std::size_t size = left & ~(class_distance - 1);
    handed_address = window.base + offset;
    taken = agnocast_je_mallocx(size, flags) == nullptr && handed_address == 0;
    offset += size;
  }
  thread_state.handing_over = false;
  handed_address = 0;
  return taken;
}

// Makes blocks come from this window from now on, in an arena of its own.
bool begin_arena(const windows::Window& window) {
  const unsigned arena = make_arena();
  if (arena == 0 || !hand_over(window, arena)) return false;
  const std::uint32_t count = arena_count.load(std::memory_order_relaxed);
  arenas[count] = arena;
  arena_count.store(count + 1, std::memory_order_release);
  current.store(packed(windows::number_of(window), arena), std::memory_order_release);
  return true;
}

}  // namespace

std::uint32_t first_window() { return first_of(current.load(std::memory_order_acquire)); }

void note_internal_error() { internal_error_count.fetch_add(1, std::memory_order_relaxed); }

void* allocate(std::size_t size) {
  const KeepErrno keep;
  const LibcOnly inside;
  bind_thread();
  return or_refused(if_in_window(agnocast_je_malloc(at_least_min(size))), size);
}

void* allocate_zeroed(std::size_t size) {
  const KeepErrno keep;
  const LibcOnly inside;
  bind_thread();
  return or_refused(if_in_window(agnocast_je_calloc(1, at_least_min(size))), size);
}

void* allocate_aligned(std::size_t alignment, std::size_t size) {
  const KeepErrno keep;
  const LibcOnly inside;
  bind_thread();
  return or_refused(if_in_window(agnocast_je_memalign(alignment, at_least_min(size))), size);
}

void* reallocate(void* block, std::size_t size) {
  std::size_t room = 0;
  {
    const KeepErrno keep;
    const LibcOnly inside;
    // In place, or not at all; in an earlier window it may only shrink.
    const std::size_t before = usable_size(block);
    room = is_given_up(*windows::window_of(block))
               ? before
               : agnocast_je_xallocx(block, at_least_min(size), 0, 0);
    count_block(before, room);
  }
  // A block that shrinks stays in place if that wastes little.
  const bool fits = room >= size;
  if (fits && (room <= 4096 || room / 2 <= size)) return block;
  void* const moved = allocate(size);
  if (moved == nullptr) return fits ? block : nullptr;
  memcpy(moved, block, room < size ? room : size);
  {
    const KeepErrno keep;
    const LibcOnly inside;
    count_block(room, 0);
    agnocast_je_free(block);
  }
  return moved;
}

namespace {

void give_back(void* block, const windows::Window& window) {
  const KeepErrno keep;
  const LibcOnly inside;
  if (is_given_up(window)) [[unlikely]] {
    agnocast_je_dallocx(block, no_cache);
  } else {
    agnocast_je_free(block);
  }
}

[[gnu::noinline, gnu::cold]] void give_back_counted(void* block, const windows::Window& window) {
  count_block(usable_size(block), 0);
  give_back(block, window);
}

}  // namespace

void release(void* block, const windows::Window& window) {
  if (!windows::is_owner()) return;
  if (!windows::is_mapped(window, block)) [[unlikely]] {  // no block was ever beyond the frontier
    note_internal_error();
    return;
  }
  if (thread_state.forking) [[unlikely]] {  // the allocator is locked: fork.cpp frees it later
    *static_cast<void**>(block) = thread_state.deferred;
    thread_state.deferred = block;
    return;
  }
  if (may_be_counted(block)) [[unlikely]]
    return give_back_counted(block, window);
  give_back(block, window);
}

std::size_t usable_size(const void* block) { return agnocast_je_malloc_usable_size(block); }

enum agnocast_heaphook_status attach(const struct agnocast_heaphook_window& window,
                                     const struct agnocast_heaphook_options& options) {
  if (getauxval(AT_SECURE) != 0) return AGNOCAST_HEAPHOOK_SECURE;
  if (options.grown == nullptr || options.scope > AGNOCAST_HEAPHOOK_SCOPE_ALL ||
      options.reserved != 0 || (window.flags & AGNOCAST_HEAPHOOK_WINDOW_FRESH) != 0) {
    return AGNOCAST_HEAPHOOK_INVALID;
  }
  State expected = State::inert;
  if (!state.compare_exchange_strong(expected, State::attaching, std::memory_order_acquire)) {
    if (expected == State::attached && !windows::is_owner()) return AGNOCAST_HEAPHOOK_FORKED;
    return AGNOCAST_HEAPHOOK_STATE;
  }
  const LibcOnly inside;
  if (const auto room = room_for(AGNOCAST_HEAPHOOK_ATTACH_BYTES); room != AGNOCAST_HEAPHOOK_OK) {
    state.store(State::inert, std::memory_order_release);
    return room;
  }
  windows::set_grown(options.grown, options.context);
  if (const auto refused = windows::add(window); refused != AGNOCAST_HEAPHOOK_OK) {
    state.store(State::inert, std::memory_order_release);
    return refused;
  }
  // From here on failures are final: fork handlers cannot be unregistered.
  start_allocator();
  if (!fork_rules::register_inner() || !begin_arena(windows::table[0]) ||
      !fork_rules::register_outer() || !windows::become_owner()) {
    windows::remove_first();
    note_internal_error();
    state.store(State::broken, std::memory_order_release);
    return AGNOCAST_HEAPHOOK_INTERNAL;
  }
  state.store(State::attached, std::memory_order_release);
  return AGNOCAST_HEAPHOOK_OK;
}

enum agnocast_heaphook_status add_window(const struct agnocast_heaphook_window& window) {
  if (state.load(std::memory_order_acquire) != State::attached) return AGNOCAST_HEAPHOOK_STATE;
  if (!windows::is_owner()) return AGNOCAST_HEAPHOOK_FORKED;
  const LibcOnly inside;
  const bool fresh = (window.flags & AGNOCAST_HEAPHOOK_WINDOW_FRESH) != 0;
  if (fresh) {
    if (const auto room = room_for(arena_bytes); room != AGNOCAST_HEAPHOOK_OK) return room;
  }
  if (const auto refused = windows::add(window); refused != AGNOCAST_HEAPHOOK_OK) return refused;
  const windows::Window& added = windows::table[windows::count.load(std::memory_order_relaxed) - 1];
  if (fresh ? !begin_arena(added)
            : !hand_over(added, arena_of(current.load(std::memory_order_relaxed)))) {
    note_internal_error();  // the window stays, unused
    return AGNOCAST_HEAPHOOK_INTERNAL;
  }
  return AGNOCAST_HEAPHOOK_OK;
}

void usage(struct agnocast_heaphook_usage& usage) {
  memset(&usage, 0, sizeof usage);
  windows::add_usage(usage);
  usage.internal_error_count = internal_error_count.load(std::memory_order_relaxed);
  if (windows::is_owner()) {
    const LibcOnly inside;
    usage.live_bytes = live_bytes();
  }
}

std::uint64_t purge() {
  if (!windows::is_owner()) return 0;
  const KeepErrno keep;
  const LibcOnly inside;
  const std::uint64_t before = windows::counters.punched_bytes.load(std::memory_order_relaxed);
  purging.fetch_add(1, std::memory_order_relaxed);
  agnocast_je_mallctl("thread.tcache.flush", nullptr, nullptr, nullptr, 0);
  for (std::uint32_t i = 0; i < arena_count.load(std::memory_order_acquire); ++i) {
    if (agnocast_je_mallctl(ArenaName("arena.", arenas[i], ".purge").text, nullptr, nullptr,
                            nullptr, 0) != 0)
      note_internal_error();
  }
  windows::punch_unused();
  purging.fetch_sub(1, std::memory_order_relaxed);
  return windows::counters.punched_bytes.load(std::memory_order_relaxed) - before;
}

namespace {

// Size classes, as the allocator counts them: slabs of small blocks, and blocks of whole pages.
struct Classes {
  const char *all, *description, *size, *group, *taken;
  std::size_t size_end;
};
constexpr Classes slabs = {"arenas.nbins", "arenas.bin.", ".slab_size",
                           ".bins.",       ".nslabs",     ~std::size_t{0}};
// Without those counted by count_block().
constexpr Classes pages = {"arenas.nlextents", "arenas.lextent.", ".size",
                           ".lextents.",       ".nmalloc",        counted_min};

// Adds the bytes of all allocations of these classes in an arena so far, reuse included. Returns
// false if the allocator has no numbers.
bool add_taken(unsigned arena, const Classes& classes, std::uint64_t& bytes) {
  unsigned count = 0;
  if (!get(classes.all, count)) return false;
  for (unsigned i = 0; i < count; ++i) {
    std::size_t size = 0;
    std::uint64_t times = 0;
    if (!get(ArenaName(classes.description, i, classes.size).text, size)) return false;
    if (size >= classes.size_end) break;  // they grow
    if (!get(ArenaName("stats.arenas.", arena, classes.group, i, classes.taken).text, times))
      return false;
    bytes += times * size;
  }
  return true;
}

}  // namespace

std::uint64_t idle() {
  if (!windows::is_owner()) return 0;
  const KeepErrno keep;
  const LibcOnly inside;
  std::size_t page = 0;
  bool known = set("epoch", std::uint64_t{1}) && get("arenas.page", page);
  std::uint64_t bytes = 0, taken = 0;
  for (std::uint32_t i = 0; known && i < arena_count.load(std::memory_order_acquire); ++i) {
    std::size_t dirty_pages = 0;
    known = get(ArenaName("stats.arenas.", arenas[i], ".pdirty").text, dirty_pages) &&
            add_taken(arenas[i], slabs, taken) && add_taken(arenas[i], pages, taken);
    bytes += dirty_pages * page;
  }
  if (!known) {
    note_internal_error();
    return 0;
  }
  const std::uint64_t now = counted_bytes.load(std::memory_order_relaxed);
  const std::uint64_t most = counted_bytes_max.exchange(now, std::memory_order_relaxed);
  static constinit std::uint64_t taken_before = 0;  // one caller at a time
  const std::uint64_t wanted = (most > now ? most - now : 0) + (taken - taken_before);
  taken_before = taken;
  return (bytes > wanted ? bytes - wanted : 0) + windows::grown_back();
}

}  // namespace agnocast::heaphook::shared_heap
