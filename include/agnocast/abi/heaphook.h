/* SPDX-License-Identifier: Apache-2.0
 *
 * How a client library steers the heap hook (libagnocast_heaphook.so, preloaded or linked).
 *
 * The hook interposes the malloc family and does nothing else until somebody calls `attach`. From then on it hands out memory
 * from up to eight *windows*: ranges of addresses that are the same in every process, backed by one memfd each, of which only
 * the first `frontier` bytes are mapped. The caller makes the memfds and announces the frontiers to readers; the hook never
 * talks to anybody. docs/heaphook.md has the drawing, the rules of fork and the limits.
 *
 * Find the hook with dlsym(RTLD_DEFAULT, "agnocast_heaphook"); when that is NULL no hook is in the process. Compare
 * `abi_version` before anything else: the layout below belongs to exactly one version.
 *
 * C, so that every language can use it. Nothing here throws, logs, ends the process or blocks on another process.
 */
#ifndef AGNOCAST_ABI_HEAPHOOK_H
#define AGNOCAST_ABI_HEAPHOOK_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/** Changes with any change of this header's layout or meaning. */
#define AGNOCAST_HEAPHOOK_ABI_VERSION 5u

/** Windows of one process. Eight of the default 16 GiB are 128 GiB of addresses: more than the memory of today's robots. */
#define AGNOCAST_HEAPHOOK_WINDOWS_MAX 8u

/** What attach maps at most: private addresses of the allocator, measured (10 MiB at its start, 6 MiB more at the first block,
 *  2 MiB alignment each time, some room to spare), and the first piece of the window. They count against RLIMIT_AS, and under
 *  mlockall(MCL_FUTURE) against RLIMIT_MEMLOCK. */
#define AGNOCAST_HEAPHOOK_ATTACH_BYTES (26u << 20)

/** What attach and add_window answer. Where a system call refused, errno holds its reason on return. */
enum agnocast_heaphook_status {
  AGNOCAST_HEAPHOOK_OK = 0,
  AGNOCAST_HEAPHOOK_SECURE = 1,      /**< The process runs with AT_SECURE (setuid and the like): inert for good. */
  AGNOCAST_HEAPHOOK_FORKED = 2,      /**< Child of a fork of an attached process: only exec makes it usable again. */
  AGNOCAST_HEAPHOOK_STATE = 3,       /**< attach was called before, or add_window without a successful attach. */
  AGNOCAST_HEAPHOOK_INVALID = 4,     /**< An argument is outside its domain; nothing was changed. */
  AGNOCAST_HEAPHOOK_OCCUPIED = 5,    /**< Something else is mapped inside the window (a library, a JIT). */
  AGNOCAST_HEAPHOOK_LOCK_LIMIT = 6,  /**< mlockall(MCL_FUTURE) is in force and RLIMIT_MEMLOCK too small: raise it. */
  AGNOCAST_HEAPHOOK_FULL = 7,        /**< AGNOCAST_HEAPHOOK_WINDOWS_MAX windows are in use. */
  AGNOCAST_HEAPHOOK_OS = 8,          /**< A system call refused for another reason: see errno. */
  AGNOCAST_HEAPHOOK_INTERNAL = 9     /**< The allocator did not start: a defect, or no memory at all. */
};

/** Which allocations come from the windows after attach. */
enum agnocast_heaphook_scope {
  AGNOCAST_HEAPHOOK_SCOPE_LOAN = 0,  /**< Those of threads between enter and leave. */
  AGNOCAST_HEAPHOOK_SCOPE_ALL = 1    /**< All, except of threads between pause and resume. */
};

/** Flag of a window: the caller has mapped all of [base, base + length) PROT_NONE and the hook may replace that. Without it
 *  the hook takes the range piece by piece and only where it is free. Reserved addresses count against RLIMIT_MEMLOCK once
 *  the process locks its memory; the piecewise way counts what is used. */
#define AGNOCAST_HEAPHOOK_WINDOW_RESERVED 1u
/** Flag of a window for add_window: from now on blocks come from this window and those added later only. What lies in earlier
 *  windows stays until it is freed, and their room is not used again. For readers that cannot map an earlier one. */
#define AGNOCAST_HEAPHOOK_WINDOW_FRESH 2u

/** One window. Both descriptors stay the caller's, which may close them: the hook duplicates them (close-on-exec). */
struct agnocast_heaphook_window {
  void* base;         /**< Fixed address, multiple of 2 MiB. */
  size_t length;      /**< Bytes, multiple of 2 MiB, at least 2 MiB; the memfd has at least this size and reads as zero. */
  int write_fd;       /**< O_RDWR descriptor of the memfd, mapped MAP_SHARED. */
  int read_fd;        /**< O_RDONLY descriptor of the same memfd: children of fork map it privately. */
  uint32_t flags;     /**< 0 or AGNOCAST_HEAPHOOK_WINDOW_RESERVED. */
  uint32_t reserved;  /**< 0. */
};

/** Stores a grown frontier where readers see it, with release order. Called with the number of the window and the bytes
 *  mapped from its base, *before* malloc returns any address beyond the old frontier. It runs in whatever thread allocates,
 *  under the allocator's locks: it must not allocate, free, block or call the hook. Calls are serialised. */
typedef void (*agnocast_heaphook_grown)(void* context, uint32_t window, uint64_t frontier_bytes);

struct agnocast_heaphook_options {
  uint32_t scope;                 /**< enum agnocast_heaphook_scope. */
  uint32_t reserved;              /**< 0. */
  agnocast_heaphook_grown grown;  /**< Required. */
  void* context;                  /**< Handed to grown. */
};

/** A snapshot; the fields are read one by one while other threads go on. Bytes unless named otherwise. */
struct agnocast_heaphook_usage {
  uint32_t window_count;             /**< 0 while inert. */
  uint32_t next_window_wanted;       /**< 1 when 75 % of the last window is used or a request did not fit, and there is room
                                          for one more: call add_window. */
  uint64_t length_bytes;             /**< Sum over the windows. */
  uint64_t used_bytes;               /**< High-water mark: what the allocator ever took. */
  uint64_t frontier_bytes;           /**< What is mapped; used_bytes <= frontier_bytes <= length_bytes. */
  uint64_t live_bytes;               /**< In blocks that are allocated now, rounded up to size classes. */
  uint64_t refused_bytes_max;        /**< Largest request that found no room since the last add_window. */
  uint64_t refused_count;            /**< Attempts in shared scope that found no room, but for those during purge and those of
                                          more than the last window's length; operator new makes two. */
  uint64_t mapping_refused_count;    /**< Growths, or views of a forked child, that the system refused: lock limit, address
                                          taken, descriptor closed by the program. */
  uint64_t punch_count;              /**< Ranges whose pages were given back. Grows inside purge only. */
  uint64_t punched_bytes;
  uint64_t internal_error_count;     /**< Not 0: report it. The endpoint should be poisoned. */
};

/** Throws a C++ exception. It must not return. */
typedef void (*agnocast_heaphook_no_room)(void);

/** The hook's functions. Thread-safe unless said otherwise. None of them allocates from the windows. */
struct agnocast_heaphook_table {
  uint32_t abi_version;  /**< AGNOCAST_HEAPHOOK_ABI_VERSION of the hook. */
  uint32_t size_bytes;   /**< sizeof(struct agnocast_heaphook_table) of the hook. */

  /** Ends inertness: maps the first piece of the first window, calls grown for it, starts the allocator (about 0.4 ms,
   *  some 16 MiB of private addresses of which little is touched) and registers fork handlers. Once per process; a refusal with
   *  INVALID, OCCUPIED, LOCK_LIMIT or OS leaves no mapping or descriptor and may be tried again. One caller at a time. */
  int (*attach)(const struct agnocast_heaphook_window* window, const struct agnocast_heaphook_options* options);

  /** The next window; its number is the previous window_count. One caller at a time. Errors as attach, and FULL. */
  int (*add_window)(const struct agnocast_heaphook_window* window);

  /** The calling thread allocates from the windows until the matching leave. Nests; a few instructions; allowed while inert. */
  void (*enter)(void);
  void (*leave)(void);

  /** Between pause and resume the calling thread allocates from libc whatever its scope is. Nests. */
  void (*pause)(void);
  void (*resume)(void);

  /** How often an allocation of the calling thread, in shared scope, found no room in the windows and went to libc instead. Only
   *  grows. Unchanged between two calls: everything allocated in between lies in the windows. */
  uint64_t (*spilled)(void);

  /** From now on operator new of the calling thread calls `no_room` where it is in shared scope and the windows have no room, and its
   *  nothrow forms answer NULL there; after NULL, which is the beginning, all take libc's memory. malloc and its family always do.
   *  Returns what was there before. For a copy that is of no use unless all of it is shared. */
  agnocast_heaphook_no_room (*on_no_room)(agnocast_heaphook_no_room no_room);

  /** For allocators that ask by themselves, whoever answers malloc in this process: size bytes from the windows, whatever the scope
   *  of the thread is; alignment is a power of two. NULL when the windows have no room, while paused or inert, and in a forked
   *  child; never libc's memory. */
  void* (*allocate)(size_t alignment, size_t size);

  /** Gives back what lies in a window, as free does, and answers 1. Leaves every other address alone and answers 0. */
  int (*deallocate)(void* block);

  /** 1 when an allocation by the calling thread would try the windows first, else 0. */
  int (*active)(void);

  /** 1 when the address lies in the mapped part of a window, else 0. A few instructions. In a forked child too. */
  int (*owns)(const void* address);

  /** Mapped bytes of a window, 0 for a number that is not in use. */
  uint64_t (*frontier)(uint32_t window);

  /** Number of the oldest window that blocks come from: 0, or that of the last FRESH one. A thread that has got a block of a FRESH
   *  window, from whomever, gets its number here. */
  uint32_t (*first_window)(void);

  /** Fills in a snapshot. Takes allocator locks for live_bytes: not for the publish path. */
  void (*usage)(struct agnocast_heaphook_usage* usage);

  /** Gives the pages of all idle memory back to the kernel (they read as zero in every process) and returns how many bytes of
   *  addresses that were. Costs a system call for each 2 MiB of them and the next use of these pages faults: for a thread that
   *  nobody waits for, after idle time. Everything goes on beside it; meanwhile idle memory is out of reach, so that a large block may
   *  lie where none was before, or not be had. Nothing else in the hook gives pages back. */
  uint64_t (*purge)(void);

  /** Bytes that purge would give back, and that nobody has wanted since the previous call: freed blocks count from the next call
   *  on. Blocks of 64 KiB and more are followed all the time; of smaller ones each page that was taken for them counts as wanted.
   *  Takes allocator locks and asks for some hundred numbers: not for the publish path. One caller at a time. */
  uint64_t (*idle)(void);

  /** next_window_wanted of usage, without any lock. */
  int (*window_wanted)(void);
};

/** The table; static, the same for the life of the process. */
__attribute__((visibility("default"))) const struct agnocast_heaphook_table* agnocast_heaphook(void);

#ifdef __cplusplus
}
#endif

#endif /* AGNOCAST_ABI_HEAPHOOK_H */
