// SPDX-License-Identifier: Apache-2.0
//
// Mapping, growth and the private view of a forked child. See windows.hpp.

#include "windows.hpp"

#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

namespace agnocast::heaphook::windows {

constinit Window table[AGNOCAST_HEAPHOOK_WINDOWS_MAX] = {};
constinit std::atomic<std::uint32_t> count{0};
constinit Counters counters = {};

namespace {

constinit const std::atomic<std::uint32_t> nobody{0};

// 2 MiB: one huge page, so that a window can be backed by huge pages from its start.
constexpr std::size_t window_granule = std::size_t{2} << 20;

// A step is an eighth of the open part, at least 2 MiB and at most 64 MiB. Locked memory then
// exceeds the used memory by an eighth or 2 MiB; a reader makes one mmap (12 us) per step: 8 up
// to 16 MiB, about 30 more up to 512 MiB, 16 per GiB later.
constexpr std::size_t step_min = std::size_t{2} << 20;
constexpr std::size_t step_max = std::size_t{64} << 20;

// Without priority inheritance: it would bound nothing, because callers have passed the
// allocator's own locks, which have none; and such a lock records its holder's thread, which in a
// forked child does not exist and cannot unlock it.
constinit pthread_mutex_t growth_mutex = PTHREAD_MUTEX_INITIALIZER;
constinit agnocast_heaphook_grown grown_callback = nullptr;  // guarded by growth_mutex
constinit void* grown_context = nullptr;

constexpr std::size_t round_up(std::size_t value, std::size_t granule) {
  return (value + granule - 1) & ~(granule - 1);
}

bool same_file(int fd, const Window& window) {
  struct stat status;
  return fstat(fd, &status) == 0 && status.st_dev == window.device && status.st_ino == window.inode;
}

void* address_in(const Window& window, std::size_t offset) {
  // The only place that makes a pointer from the window's numeric base.
  return reinterpret_cast<void*>(window.base + offset);
}

// The file is as long as its mapped part: a reader that touches a hole allocates a page, but
// cannot touch anything beyond the end.
bool lengthen(const Window& window, std::size_t target) {
  struct stat status;
  if (fstat(window.write_fd, &status) != 0) return false;
  if (static_cast<std::size_t>(status.st_size) >= target) return true;
  struct rlimit limit;
  if (getrlimit(RLIMIT_FSIZE, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY &&
      target > limit.rlim_cur) {
    errno = EFBIG;  // ftruncate would send SIGXFSZ as well
    return false;
  }
  return ftruncate(window.write_fd, static_cast<off_t>(target)) == 0;
}

// Opens [frontier, target) of the window. Returns false with the kernel's errno.
bool open_to(Window& window, std::uint32_t index, std::size_t target) {
  const std::size_t frontier = window.frontier.load(std::memory_order_relaxed);
  if (!same_file(window.write_fd, window)) {
    errno = EBADF;
    return false;
  }
  if (!lengthen(window, target)) return false;
  void* const wanted = address_in(window, frontier);
  // MAP_FIXED replaces the caller's PROT_NONE reservation; MAP_FIXED_NOREPLACE refuses to replace
  // any other mapping.
  const int placement = window.reserved ? MAP_FIXED : MAP_FIXED_NOREPLACE;
  void* const piece = mmap(wanted, target - frontier, PROT_READ | PROT_WRITE,
                           MAP_SHARED | placement, window.write_fd, static_cast<off_t>(frontier));
  if (piece == MAP_FAILED) return false;
  if (piece != wanted || madvise(piece, target - frontier, MADV_DONTFORK) != 0) {
    const int reason = errno;
    munmap(piece, target - frontier);
    errno = reason;
    return false;
  }
  // Where the system leaves it to us (shmem_enabled is advise) a large message faults once per 2
  // MiB. Failure elsewhere is harmless.
  madvise(piece, target - frontier, MADV_HUGEPAGE);
  // Announced before the arena returns an address beyond the old frontier, so before any message
  // points there.
  window.frontier.store(target, std::memory_order_release);
  grown_callback(grown_context, index, target);
  return true;
}

bool grow(Window& window, std::uint32_t index, std::size_t needed) {
  const std::size_t frontier = window.frontier.load(std::memory_order_relaxed);
  if (needed <= frontier) return true;
  std::size_t step = frontier / 8;
  if (step < step_min) step = step_min;
  if (step > step_max) step = step_max;
  std::size_t target = round_up(frontier + step > needed ? frontier + step : needed, step_min);
  if (target > window.length) target = window.length;
  if (open_to(window, index, target)) return true;
  // A lock limit may have room for the needed bytes but not for the whole step.
  const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  const std::size_t least = round_up(needed, page);
  if (least < target && open_to(window, index, least)) return true;
  counters.mapping_refused_count.fetch_add(1, std::memory_order_relaxed);
  return false;
}

enum agnocast_heaphook_status status_of_errno() {
  switch (errno) {
    case EEXIST:
      return AGNOCAST_HEAPHOOK_OCCUPIED;
    case EAGAIN:
      return AGNOCAST_HEAPHOOK_LOCK_LIMIT;  // the only EAGAIN of mmap(2): locked memory
    default:
      return AGNOCAST_HEAPHOOK_OS;
  }
}

enum agnocast_heaphook_status check(const struct agnocast_heaphook_window& window,
                                    struct stat& status) {
  const auto base = reinterpret_cast<std::uintptr_t>(window.base);
  if (base == 0 || base % window_granule != 0 || window.length == 0 ||
      window.length % window_granule != 0 || base + window.length < base ||
      (window.flags & ~(AGNOCAST_HEAPHOOK_WINDOW_RESERVED | AGNOCAST_HEAPHOOK_WINDOW_FRESH)) != 0 ||
      window.reserved != 0) {
    return AGNOCAST_HEAPHOOK_INVALID;
  }
  for (std::uint32_t i = 0; i < count.load(std::memory_order_relaxed); ++i) {
    if (base < table[i].base + table[i].length && table[i].base < base + window.length)
      return AGNOCAST_HEAPHOOK_INVALID;
  }
  struct stat read_status;
  if (fstat(window.write_fd, &status) != 0 || fstat(window.read_fd, &read_status) != 0)
    return AGNOCAST_HEAPHOOK_OS;
  const int write_flags = fcntl(window.write_fd, F_GETFL);
  const int read_flags = fcntl(window.read_fd, F_GETFL);
  const int seals =
      fcntl(window.write_fd, F_GET_SEALS);  // -1 for a file without seals: all bits set
  if (status.st_dev != read_status.st_dev || status.st_ino != read_status.st_ino ||
      status.st_size < 0 ||
      ((seals & F_SEAL_GROW) != 0 && static_cast<std::size_t>(status.st_size) < window.length) ||
      (write_flags & O_ACCMODE) != O_RDWR || (read_flags & O_ACCMODE) != O_RDONLY) {
    return AGNOCAST_HEAPHOOK_INVALID;
  }
  return AGNOCAST_HEAPHOOK_OK;
}

void close_both(const Window& window) {
  const int reason = errno;
  if (window.write_fd >= 0) close(window.write_fd);
  if (window.read_fd >= 0) close(window.read_fd);
  errno = reason;
}

constexpr std::size_t bit_bytes = 4096;  // the allocator's pages are no smaller
constexpr std::size_t map_bytes(std::size_t length) {
  return (length / bit_bytes + 63) / 64 * sizeof(std::uint64_t);
}

bool is_closed(const Window& window, std::size_t bit) {
  return (window.closed[bit / 64] >> bit % 64 & 1) != 0;
}

// Call it under the growth lock.
void mark(Window& window, std::size_t offset, std::size_t length, bool closed) {
  if (!closed && window.closed_bytes == 0) return;
  for (std::size_t bit = offset / bit_bytes; bit < (offset + length) / bit_bytes; ++bit) {
    if (is_closed(window, bit) == closed) continue;
    window.closed[bit / 64] ^= std::uint64_t{1} << bit % 64;
    window.closed_bytes += closed ? bit_bytes : -bit_bytes;
  }
}

}  // namespace

constinit std::atomic<const std::atomic<std::uint32_t>*> owner_word{&nobody};

void lock_growth() { pthread_mutex_lock(&growth_mutex); }
void unlock_growth() { pthread_mutex_unlock(&growth_mutex); }

bool become_owner() {
  const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  void* const word =
      mmap(nullptr, page, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (word == MAP_FAILED) return false;
  if (madvise(word, page, MADV_WIPEONFORK) != 0) {
    const int reason = errno;
    munmap(word, page);
    errno = reason;
    return false;
  }
  auto* const owner =
      static_cast<std::atomic<std::uint32_t>*>(word);  // zero pages are a zero atomic
  owner->store(1, std::memory_order_relaxed);
  owner_word.store(owner, std::memory_order_release);
  return true;
}

void set_grown(agnocast_heaphook_grown grown, void* context) {
  lock_growth();
  grown_callback = grown;
  grown_context = context;
  unlock_growth();
}

enum agnocast_heaphook_status add(const struct agnocast_heaphook_window& window) {
  const std::uint32_t index = count.load(std::memory_order_relaxed);
  if (index == AGNOCAST_HEAPHOOK_WINDOWS_MAX) return AGNOCAST_HEAPHOOK_FULL;
  struct stat status;
  if (const auto refused = check(window, status); refused != AGNOCAST_HEAPHOOK_OK) return refused;

  Window& slot = table[index];
  slot.write_fd = fcntl(window.write_fd, F_DUPFD_CLOEXEC, 3);
  slot.read_fd = fcntl(window.read_fd, F_DUPFD_CLOEXEC, 3);
  if (slot.write_fd < 0 || slot.read_fd < 0) {
    close_both(slot);
    return AGNOCAST_HEAPHOOK_OS;
  }
  slot.base = reinterpret_cast<std::uintptr_t>(window.base);
  slot.length = window.length;
  slot.device = status.st_dev;
  slot.inode = status.st_ino;
  slot.reserved = (window.flags & AGNOCAST_HEAPHOOK_WINDOW_RESERVED) != 0;
  slot.used.store(0, std::memory_order_relaxed);
  slot.frontier.store(0, std::memory_order_relaxed);
  void* const bits = mmap(nullptr, map_bytes(slot.length), PROT_READ | PROT_WRITE,
                          MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (bits == MAP_FAILED) {
    const auto refused = status_of_errno();
    close_both(slot);
    return refused;
  }
  slot.closed = static_cast<std::uint64_t*>(bits);
  slot.closed_bytes = 0;
  slot.stuck_bytes = 0;

  lock_growth();
  const bool opened = open_to(slot, index, step_min);
  if (opened) {
    counters.refused_bytes_max.store(0, std::memory_order_relaxed);
    count.store(index + 1, std::memory_order_release);
  }
  unlock_growth();
  if (opened) return AGNOCAST_HEAPHOOK_OK;
  const int reason = errno;
  munmap(bits, map_bytes(slot.length));
  errno = reason;
  close_both(slot);
  return status_of_errno();
}

void remove_first() {
  lock_growth();
  const int reason = errno;
  count.store(0, std::memory_order_release);
  Window& window = table[0];
  const std::size_t frontier = window.frontier.load(std::memory_order_relaxed);
  munmap(address_in(window, 0), frontier);
  if (window.reserved) {  // the addresses were reserved before us: keep them reserved
    (void)mmap(address_in(window, 0), frontier, PROT_NONE,
               MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE | MAP_FIXED_NOREPLACE, -1, 0);
  }
  munmap(window.closed, map_bytes(window.length));
  close_both(window);
  errno = reason;
  unlock_growth();
}

bool open(void* address, std::size_t length) {
  lock_growth();
  const std::uint32_t window_count = count.load(std::memory_order_relaxed);
  bool opened = false;
  for (std::uint32_t i = 0; i < window_count; ++i) {
    Window& window = table[i];
    const std::size_t start = reinterpret_cast<std::uintptr_t>(address) - window.base;
    if (start >= window.length || length > window.length - start) continue;
    opened = grow(window, i, start + length);
    if (opened) mark(window, start, length, false);
    if (opened && start + length > window.used.load(std::memory_order_relaxed)) {
      window.used.store(start + length, std::memory_order_relaxed);
    }
  }
  unlock_growth();
  return opened;
}

namespace {

// While the kernel punches a hole, every process that maps the same memfd waits, a growing malloc
// here or a reader elsewhere: about half a millisecond for 2 MiB, and as much for each 2 MiB of a
// large extent at once.
constexpr std::size_t slice_bytes = std::size_t{2} << 20;

bool punch_slice(char* address, std::size_t length) {
  if (madvise(address, length, MADV_REMOVE) == 0) return true;
  // Refused for locked memory (mlockall); a hole in the file is allowed.
  const Window* const window = window_of(address);
  if (errno != EINVAL || window == nullptr || !same_file(window->write_fd, *window)) return false;
  const std::size_t offset = reinterpret_cast<std::uintptr_t>(address) - window->base;
  return fallocate(window->write_fd, FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE,
                   static_cast<off_t>(offset), static_cast<off_t>(length)) == 0;
}

bool punch(void* address, std::size_t length) {
  char* const begin = static_cast<char*>(address);
  // Slices end at huge page boundaries.
  std::size_t done = 0;
  while (done < length) {
    const std::size_t to_boundary =
        slice_bytes - (reinterpret_cast<std::uintptr_t>(begin) + done) % slice_bytes;
    const std::size_t slice = length - done < to_boundary ? length - done : to_boundary;
    if (!punch_slice(begin + done, slice)) return false;
    done += slice;
  }
  counters.punch_count.fetch_add(1, std::memory_order_relaxed);
  counters.punched_bytes.fetch_add(length, std::memory_order_relaxed);
  return true;
}

// Returns the allocated bytes beyond those in use. Used memory that was never touched makes the
// result smaller.
std::size_t grown_back_in(const Window& window) {
  struct stat status;
  if (!same_file(window.write_fd, window) || fstat(window.write_fd, &status) != 0) return 0;
  const std::size_t there = static_cast<std::size_t>(status.st_blocks) * 512;
  const std::size_t in_use = window.used.load(std::memory_order_relaxed) - window.closed_bytes;
  const std::size_t more = there > in_use ? there - in_use : 0;
  const std::size_t unused = window.frontier.load(std::memory_order_relaxed) - in_use;
  return more < unused ? more : unused;
}

// Returns whether the page is not in use: it was returned, or never used.
bool is_unused(const Window& window, std::size_t offset) {
  return offset >= window.used.load(std::memory_order_relaxed) ||
         is_closed(window, offset / bit_bytes);
}

}  // namespace

bool shut(void* address, std::size_t length) {
  Window* window = nullptr;
  for (std::uint32_t i = 0; i < count.load(std::memory_order_acquire); ++i) {
    if (reinterpret_cast<std::uintptr_t>(address) - table[i].base < table[i].length)
      window = &table[i];
  }
  if (window == nullptr) return false;
  std::size_t at = reinterpret_cast<std::uintptr_t>(address) - window->base;
  const std::size_t end = at + length;
  while (at < end) {
    lock_growth();
    while (at < end && is_closed(*window, at / bit_bytes)) at += bit_bytes;
    std::size_t run_end = at;
    while (run_end < end && !is_closed(*window, run_end / bit_bytes)) run_end += bit_bytes;
    unlock_growth();
    if (run_end == at) break;
    // Unlocked: the caller keeps these pages out of use.
    if (!punch(address_in(*window, at), run_end - at)) return false;
    lock_growth();
    mark(*window, at, run_end - at, true);
    unlock_growth();
    at = run_end;
  }
  return true;
}

std::uint64_t closed_bytes() {
  std::uint64_t bytes = 0;
  lock_growth();
  for (std::uint32_t i = 0; i < count.load(std::memory_order_relaxed); ++i)
    bytes += table[i].closed_bytes;
  unlock_growth();
  return bytes;
}

void count_refused(std::size_t size) {
  // The windows are not full if the request is larger than one.
  const std::uint32_t window_count = count.load(std::memory_order_acquire);
  if (window_count != 0 && size <= table[window_count - 1].length)
    counters.refused_count.fetch_add(1, std::memory_order_relaxed);
  auto& most = counters.refused_bytes_max;
  std::uint64_t seen = most.load(std::memory_order_relaxed);
  while (size > seen && !most.compare_exchange_weak(seen, size, std::memory_order_relaxed)) {
  }
}

bool wants_another() {
  const std::uint32_t window_count = count.load(std::memory_order_acquire);
  if (window_count == 0 || window_count == AGNOCAST_HEAPHOOK_WINDOWS_MAX) return false;
  const Window& last = table[window_count - 1];
  return last.used.load(std::memory_order_relaxed) >= last.length / 4 * 3 ||
         counters.refused_bytes_max.load(std::memory_order_relaxed) > 0;
}

void add_usage(struct agnocast_heaphook_usage& usage) {
  usage.window_count = count.load(std::memory_order_acquire);
  for (std::uint32_t i = 0; i < usage.window_count; ++i) {
    usage.length_bytes += table[i].length;
    usage.used_bytes += table[i].used.load(std::memory_order_relaxed);
    usage.frontier_bytes += table[i].frontier.load(std::memory_order_relaxed);
  }
  usage.refused_bytes_max = counters.refused_bytes_max.load(std::memory_order_relaxed);
  usage.refused_count = counters.refused_count.load(std::memory_order_relaxed);
  usage.mapping_refused_count = counters.mapping_refused_count.load(std::memory_order_relaxed);
  usage.punch_count = counters.punch_count.load(std::memory_order_relaxed);
  usage.punched_bytes = counters.punched_bytes.load(std::memory_order_relaxed);
  usage.next_window_wanted = wants_another();
}

std::uint64_t grown_back() {
  std::uint64_t bytes = 0;
  lock_growth();
  for (std::uint32_t i = 0; i < count.load(std::memory_order_relaxed); ++i) {
    const std::size_t more = grown_back_in(table[i]);
    if (more > table[i].stuck_bytes) bytes += more - table[i].stuck_bytes;
  }
  unlock_growth();
  return bytes;
}

void punch_unused() {
  for (std::uint32_t i = 0; i < count.load(std::memory_order_acquire); ++i) {
    Window& window = table[i];
    lock_growth();
    const bool has_grown = grown_back_in(window) > window.stuck_bytes;
    unlock_growth();
    if (!has_grown) continue;
    // Releases the lock after each slice, so a thread that opens memory waits for one slice at
    // most.
    const std::size_t end = window.frontier.load(std::memory_order_relaxed);
    for (std::size_t slice = 0; slice < end; slice += slice_bytes) {
      lock_growth();
      const std::size_t slice_end = slice + slice_bytes < end ? slice + slice_bytes : end;
      for (std::size_t at = slice; at < slice_end; at += bit_bytes) {
        const std::size_t begin = at;
        while (at < slice_end && is_unused(window, at)) at += bit_bytes;
        if (at > begin) punch(address_in(window, begin), at - begin);
      }
      unlock_growth();
    }
    lock_growth();
    window.stuck_bytes = grown_back_in(window);
    unlock_growth();
  }
}

void map_private_view() {
  const std::uint32_t window_count = count.load(std::memory_order_relaxed);
  for (std::uint32_t i = 0; i < window_count; ++i) {
    const Window& window = table[i];
    const std::size_t frontier = window.frontier.load(std::memory_order_relaxed);
    void* const wanted = address_in(window, 0);
    void* const view =
        same_file(window.read_fd, window)
            ? mmap(wanted, frontier, PROT_READ | PROT_WRITE,
                   MAP_PRIVATE | MAP_NORESERVE | MAP_FIXED_NOREPLACE, window.read_fd, 0)
            : MAP_FAILED;
    if (view != wanted) {
      if (view != MAP_FAILED) munmap(view, frontier);
      counters.mapping_refused_count.fetch_add(1, std::memory_order_relaxed);
    }
  }
}

}  // namespace agnocast::heaphook::windows
