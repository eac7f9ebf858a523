// SPDX-License-Identifier: Apache-2.0

#include <base/immortal.hpp>
#include <client/heap/block_heap.hpp>
#include <heaphook/windows.hpp>

#include <pthread.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <compare>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <map>
#include <mutex>
#include <new>
#include <set>
#include <utility>

namespace agnocast {
namespace {

namespace heap_windows = heaphook::windows;

// A cache line: blocks of two messages never share one.
constexpr std::size_t block_unit = 64;

constexpr std::uintptr_t round_down(std::uintptr_t value, std::size_t unit) {
  return value & ~std::uintptr_t{unit - 1};
}
constexpr std::uintptr_t round_up(std::uintptr_t value, std::size_t unit) {
  return round_down(value + (unit - 1), unit);
}

void* pointer_to(std::uintptr_t address) noexcept { return reinterpret_cast<void*>(address); }

class BlockHeap {
 public:
  int attach(const agnocast_heaphook_window& window, const agnocast_heaphook_options& options) {
    if (options.grown == nullptr || (window.flags & AGNOCAST_HEAPHOOK_WINDOW_FRESH) != 0)
      return AGNOCAST_HEAPHOOK_INVALID;
    if (heap_windows::count.load(std::memory_order_acquire) != 0)
      return heap_windows::is_owner() ? AGNOCAST_HEAPHOOK_STATE : AGNOCAST_HEAPHOOK_FORKED;
    const std::lock_guard lock(mutex_);
    heap_windows::set_grown(options.grown, options.context);
    const auto added = heap_windows::add(window);
    if (added != AGNOCAST_HEAPHOOK_OK) return added;
    // Once: handlers cannot be unregistered.
    has_fork_handlers_ = has_fork_handlers_ || register_fork_handlers();
    if (!has_fork_handlers_ || !heap_windows::become_owner()) {
      heap_windows::remove_first();
      return AGNOCAST_HEAPHOOK_OS;
    }
    end_[0] = heap_windows::table[0].base;
    return AGNOCAST_HEAPHOOK_OK;
  }

  int add_window(const agnocast_heaphook_window& window) {
    if (!heap_windows::is_owner())
      return heap_windows::count.load(std::memory_order_relaxed) == 0 ? AGNOCAST_HEAPHOOK_STATE
                                                                      : AGNOCAST_HEAPHOOK_FORKED;
    const std::lock_guard lock(mutex_);
    const auto added = heap_windows::add(window);
    if (added != AGNOCAST_HEAPHOOK_OK) return added;
    const std::uint32_t number = heap_windows::count.load(std::memory_order_relaxed) - 1;
    end_[number] = heap_windows::table[number].base;
    if ((window.flags & AGNOCAST_HEAPHOOK_WINDOW_FRESH) != 0) {
      first_.store(number, std::memory_order_release);
      retired_.merge(free_);
    }
    return added;
  }

  void* allocate(std::size_t alignment, std::size_t size) noexcept {
    if (!heap_windows::is_owner() || size > size_max) return nullptr;
    size = round_up(std::max<std::size_t>(size, 1), block_unit);
    alignment = std::max(alignment, block_unit);
    try {
      const std::lock_guard lock(mutex_);
      if (void* const block = take(alignment, size); block != nullptr) return block;
    } catch (const std::bad_alloc&) {
      return nullptr;  // the bookkeeping's memory: the windows may have room
    }
    // Extents that purge() returns just now are available again afterwards.
    if (purging_.load(std::memory_order_relaxed) == 0) heap_windows::count_refused(size);
    return nullptr;
  }

  int deallocate(void* block) noexcept {
    if (heap_windows::window_of(block) == nullptr) return 0;
    if (!heap_windows::is_owner()) return 1;
    const std::lock_guard lock(mutex_);
    const auto found = extents_.find(reinterpret_cast<std::uintptr_t>(block));
    if (found == extents_.end() || is_free(found->second)) {
      internal_error_count_.fetch_add(1, std::memory_order_relaxed);
      return 1;
    }
    live_bytes_ -= found->second.length;
    found->second.is_dirty = true;
    give(found);
    return 1;
  }

  std::uint32_t first_window() const noexcept { return first_.load(std::memory_order_acquire); }

  void usage(agnocast_heaphook_usage& usage) noexcept {
    usage = {};
    heap_windows::add_usage(usage);
    usage.internal_error_count = internal_error_count_.load(std::memory_order_relaxed);
    if (!heap_windows::is_owner()) return;
    const std::lock_guard lock(mutex_);
    usage.live_bytes = live_bytes_;
  }

  std::uint64_t purge() noexcept {
    if (!heap_windows::is_owner()) return 0;
    const std::uint64_t before =
        heap_windows::counters.punched_bytes.load(std::memory_order_relaxed);
    purging_.fetch_add(1, std::memory_order_relaxed);
    std::unique_lock lock(mutex_);
    for (auto at = extents_.begin(); at != extents_.end();) {
      const std::uintptr_t address = at->first;
      Extent& extent = at->second;
      const Pages pages = pages_of(*at);
      if (is_free(extent) && extent.is_dirty && pages.length != 0) {
        // As if in use: other threads continue.
        keep(at);
        lock.unlock();
        const bool is_shut = heap_windows::shut(pointer_to(pages.address), pages.length);
        lock.lock();
        extent.is_dirty = !is_shut;
        give(at);
      }
      at = extents_.upper_bound(address);
    }
    lock.unlock();
    heap_windows::punch_unused();
    purging_.fetch_sub(1, std::memory_order_relaxed);
    lock.lock();
    closed_before_ = heap_windows::closed_bytes();
    return heap_windows::counters.punched_bytes.load(std::memory_order_relaxed) - before;
  }

  // What was free all the time, without what was closed already: only purge() closes pages.
  std::uint64_t idle() noexcept {
    if (!heap_windows::is_owner()) return 0;
    std::uint64_t bytes = 0;
    {
      const std::lock_guard lock(mutex_);
      const std::uint64_t least = std::exchange(free_bytes_min_, free_bytes_);
      const std::uint64_t closed = std::exchange(closed_before_, heap_windows::closed_bytes());
      bytes = least > closed ? least - closed : 0;
    }
    return bytes + heap_windows::grown_back();
  }

 private:
  // Beyond the addresses of any machine; sums with it do not overflow.
  static constexpr std::size_t size_max = std::size_t{1} << 56;

  struct Place {
    std::uint32_t window;
    std::size_t length;
    std::uintptr_t address;
    auto operator<=>(const Place&) const = default;  // NOLINT(modernize-use-nullptr): a false alarm
  };
  using Places = std::set<Place>;
  struct Extent {
    std::size_t length = 0;
    // The node for the index, which an extent in use keeps, so that freeing it needs no memory;
    // empty: it is free, and in the index.
    Places::node_type place;
    bool is_dirty = false;  // some page may be open although the extent is free
  };
  using Extents = std::map<std::uintptr_t, Extent>;
  struct Pages {
    std::uintptr_t address;
    std::size_t length;
  };

  static bool is_free(const Extent& extent) noexcept { return extent.place.empty(); }
  static std::uint32_t window_of(std::uintptr_t address) noexcept {
    return heap_windows::number_of(*heap_windows::window_of(pointer_to(address)));
  }
  /// Returns the whole pages of an extent.
  Pages pages_of(const Extents::value_type& extent) const noexcept {
    const std::uintptr_t begin = round_up(extent.first, page_bytes_);
    const std::uintptr_t end = round_down(extent.first + extent.second.length, page_bytes_);
    return {begin, end > begin ? end - begin : 0};
  }
  static Place place_of(const Extents::value_type& extent) noexcept {
    return {window_of(extent.first), extent.second.length, extent.first};
  }
  Places& index_of(std::uintptr_t address) noexcept {
    return window_of(address) < first_.load(std::memory_order_relaxed) ? retired_ : free_;
  }

  static bool register_fork_handlers() noexcept;

  /// Makes an extent that is in use. Throws std::bad_alloc.
  static Extents::node_type make_extent() {
    Extents extents;
    Places places;
    places.insert(Place{});
    extents.try_emplace(0).first->second.place = places.extract(places.begin());
    return extents.extract(extents.begin());
  }
  Extents::iterator insert(Extents::node_type&& extent, std::uintptr_t address,
                           std::size_t length) noexcept {
    extent.key() = address;
    extent.mapped().length = length;
    return extents_.insert(std::move(extent)).position;
  }

  /// Takes a free extent out of the index.
  void keep(Extents::iterator extent) noexcept {
    extent->second.place = index_of(extent->first).extract(place_of(*extent));
    free_bytes_ -= pages_of(*extent).length;
  }

  /// Puts an extent that is in use into the index, joined with its free neighbours.
  void give(Extents::iterator extent) noexcept {
    if (const auto next = std::next(extent);
        are_neighbours(extent, next) && is_free(next->second)) {
      keep(next);
      join(extent, next);
    }
    if (extent != extents_.begin()) {
      const auto before = std::prev(extent);
      if (are_neighbours(before, extent) && is_free(before->second)) {
        keep(before);
        join(before, extent);
        extent = before;
      }
    }
    free_bytes_ += pages_of(*extent).length;
    extent->second.place.value() = place_of(*extent);
    index_of(extent->first).insert(std::move(extent->second.place));
  }
  bool are_neighbours(Extents::iterator low, Extents::iterator high) const noexcept {
    return high != extents_.end() && low->first + low->second.length == high->first &&
           window_of(low->first) == window_of(high->first);
  }
  void join(Extents::iterator low, Extents::iterator high) noexcept {
    low->second.length += high->second.length;
    low->second.is_dirty = low->second.is_dirty || high->second.is_dirty;
    extents_.erase(high);
  }

  /// Throws std::bad_alloc.
  void* take(std::size_t alignment, std::size_t size) {
    const std::uint32_t count = heap_windows::count.load(std::memory_order_acquire);
    for (std::uint32_t window = first_.load(std::memory_order_relaxed); window < count; ++window) {
      for (auto place = free_.lower_bound(Place{window, size, 0});
           place != free_.end() && place->window == window; ++place) {
        const std::uintptr_t start = round_up(place->address, alignment);
        if (start - place->address <= place->length - size)
          return cut(extents_.find(place->address), start, size);
      }
      if (void* const block = lengthen(window, alignment, size); block != nullptr) return block;
    }
    return nullptr;
  }

  /// Makes [start, start + size) of a free extent a block.
  void* cut(Extents::iterator extent, std::uintptr_t start, std::size_t size) {
    const std::uintptr_t begin = extent->first;
    const std::size_t before = start - begin, after = extent->second.length - before - size;
    Extents::node_type block, rest;
    if (before != 0) block = make_extent();
    if (after != 0) rest = make_extent();
    if (!open(start, size)) return nullptr;
    keep(extent);
    if (after != 0) {
      extent->second.length -= after;
      const auto tail = insert(std::move(rest), start + size, after);
      tail->second.is_dirty = extent->second.is_dirty;
      give(tail);
    }
    if (before != 0) {
      extent->second.length = before;
      (void)insert(std::move(block), start, size);
      give(extent);
    }
    live_bytes_ += size;
    free_bytes_min_ = std::min(free_bytes_min_, free_bytes_);
    return pointer_to(start);
  }

  /// Makes a block at the end of a window's used part, and a free extent of what alignment skips.
  /// Returns null if there is no room. Throws std::bad_alloc.
  void* lengthen(std::uint32_t number, std::size_t alignment, std::size_t size) {
    const heap_windows::Window& window = heap_windows::table[number];
    std::uintptr_t& end = end_[number];
    const auto last = last_free_of(window, end);
    const std::uintptr_t start = round_up(last != extents_.end() ? last->first : end, alignment);
    const std::uintptr_t limit = window.base + window.length;
    if (start > limit || size > limit - start) return nullptr;
    Extents::node_type added = make_extent();
    if (!open(start, size)) return nullptr;
    // The new part is a free extent first, of which the block is cut.
    const std::uintptr_t old_end = std::exchange(end, start + size);
    const auto skipped = insert(std::move(added), old_end, end - old_end);
    skipped->second.is_dirty = true;  // opened only in part
    give(skipped);
    return cut(std::prev(extents_.upper_bound(start)), start, size);
  }
  /// Returns the free extent that ends the used part of a window; end(): none.
  Extents::iterator last_free_of(const heap_windows::Window& window, std::uintptr_t end) noexcept {
    const auto next = extents_.lower_bound(end);
    if (end == window.base || next == extents_.begin()) return extents_.end();
    const auto last = std::prev(next);
    return is_free(last->second) ? last : extents_.end();
  }

  bool open(std::uintptr_t start, std::size_t size) const noexcept {
    const std::uintptr_t begin = round_down(start, page_bytes_);
    return heap_windows::open(pointer_to(begin), round_up(start + size, page_bytes_) - begin);
  }

  const std::size_t page_bytes_ = static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
  bool has_fork_handlers_ = false;
  // Recursive: a fork holds it, so that no thread opens memory meanwhile, while fork handlers of
  // other libraries may allocate and free in this thread. A forked child never locks it.
  std::recursive_mutex mutex_;
  bool forks_ = false;  // guarded by mutex_
  Extents extents_;     // each window's up to end_, without gaps
  Places free_;         // of windows from first_ on
  Places retired_;      // of earlier ones: never used again
  std::uintptr_t end_[AGNOCAST_HEAPHOOK_WINDOWS_MAX] = {};
  std::uint64_t live_bytes_ = 0;
  std::uint64_t free_bytes_ = 0;      // whole pages of free extents
  std::uint64_t free_bytes_min_ = 0;  // since the last idle()
  std::uint64_t closed_before_ = 0;   // at the last idle() or purge()
  std::atomic<std::uint32_t> first_{0};
  std::atomic<std::uint32_t> purging_{0};
  std::atomic<std::uint64_t> internal_error_count_{0};
};

BlockHeap& heap() noexcept { return immortal<BlockHeap>(); }

// In the child the mutex stays locked.
bool BlockHeap::register_fork_handlers() noexcept {
  return ::pthread_atfork(
             [] {
               if (!heap_windows::is_owner()) return;
               heap().mutex_.lock();
               heap().forks_ = true;
             },
             [] {
               if (!std::exchange(heap().forks_, false)) return;
               heap().mutex_.unlock();
             },
             [] {
               if (std::exchange(heap().forks_, false)) heap_windows::map_private_view();
             }) == 0;
}

int attach(const agnocast_heaphook_window* window, const agnocast_heaphook_options* options) {
  return heap().attach(*window, *options);
}
int add_window(const agnocast_heaphook_window* window) { return heap().add_window(*window); }
void nothing() {}
std::uint64_t spilled() { return 0; }
agnocast_heaphook_no_room on_no_room(agnocast_heaphook_no_room) { return nullptr; }
void* allocate(std::size_t alignment, std::size_t size) { return heap().allocate(alignment, size); }
int deallocate(void* block) { return heap().deallocate(block); }
int active() { return 0; }
int owns(const void* address) {
  const heap_windows::Window* const window = heap_windows::window_of(address);
  return window != nullptr && heap_windows::is_mapped(*window, address) ? 1 : 0;
}
std::uint64_t frontier(std::uint32_t window) {
  if (window >= heap_windows::count.load(std::memory_order_acquire)) return 0;
  return heap_windows::table[window].frontier.load(std::memory_order_acquire);
}
std::uint32_t first_window() { return heap().first_window(); }
void usage(agnocast_heaphook_usage* usage) { heap().usage(*usage); }
std::uint64_t purge() { return heap().purge(); }
std::uint64_t idle() { return heap().idle(); }
int window_wanted() { return heap_windows::wants_another() ? 1 : 0; }

constexpr agnocast_heaphook_table table = {
    .abi_version = AGNOCAST_HEAPHOOK_ABI_VERSION,
    .size_bytes = sizeof(agnocast_heaphook_table),
    .attach = attach,
    .add_window = add_window,
    .enter = nothing,
    .leave = nothing,
    .pause = nothing,
    .resume = nothing,
    .spilled = spilled,
    .on_no_room = on_no_room,
    .allocate = allocate,
    .deallocate = deallocate,
    .active = active,
    .owns = owns,
    .frontier = frontier,
    .first_window = first_window,
    .usage = usage,
    .purge = purge,
    .idle = idle,
    .window_wanted = window_wanted,
};

}  // namespace

const agnocast_heaphook_table& block_heap() noexcept { return table; }

}  // namespace agnocast
