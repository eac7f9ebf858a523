/* SPDX-License-Identifier: Apache-2.0
 *
 * Interface between a client library and the heap hook (libagnocast_heaphook.so, preloaded or
 * linked).
 *
 * The hook interposes the malloc family and passes calls through until `attach`. Then it allocates
 * from up to eight *windows*: address ranges that are the same in every process, each backed by one
 * memfd, of which only the first `frontier` bytes are mapped. The caller makes the memfds and
 * announces the frontiers to readers; the hook communicates with no other process. docs/heaphook.md
 * has the drawing, the rules of fork and the limits.
 *
 * Find the hook with dlsym(RTLD_DEFAULT, "agnocast_heaphook"); NULL means that the process has no
 * hook. Compare `abi_version` before anything else: the layout below belongs to exactly one
 * version.
 *
 * C, so that every language can use it. No function throws, logs, ends the process or blocks on
 * another process.
 */
#ifndef AGNOCAST_ABI_HEAPHOOK_H
#define AGNOCAST_ABI_HEAPHOOK_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/** Increment it with every change of this header's layout or meaning. */
#define AGNOCAST_HEAPHOOK_ABI_VERSION 5u

/** Windows of one process. Eight of the default 16 GiB are 128 GiB of addresses: more than the
 *  memory of today's robots. */
#define AGNOCAST_HEAPHOOK_WINDOWS_MAX 8u

/** Upper bound of the bytes that attach maps: private addresses of the allocator, measured (10
 *  MiB at its start, 6 MiB more at the first block, 2 MiB alignment each time, some reserve), and
 *  the first piece of the window. They count against RLIMIT_AS, and under mlockall(MCL_FUTURE)
 *  against RLIMIT_MEMLOCK. */
#define AGNOCAST_HEAPHOOK_ATTACH_BYTES (26u << 20)

/** Results of attach and add_window. If a system call failed, errno holds its error on return. */
enum agnocast_heaphook_status {
  AGNOCAST_HEAPHOOK_OK = 0,
  AGNOCAST_HEAPHOOK_SECURE = 1,     /**< The process runs with AT_SECURE (setuid etc.): inert for
                                         good. */
  AGNOCAST_HEAPHOOK_FORKED = 2,     /**< Forked child of an attached process: usable only after
                                         exec. */
  AGNOCAST_HEAPHOOK_STATE = 3,      /**< Second attach, or add_window without a successful
                                         attach. */
  AGNOCAST_HEAPHOOK_INVALID = 4,    /**< An argument is outside its domain; nothing was
                                         changed. */
  AGNOCAST_HEAPHOOK_OCCUPIED = 5,   /**< Another mapping is inside the window (a library, a
                                         JIT). */
  AGNOCAST_HEAPHOOK_LOCK_LIMIT = 6, /**< Raise RLIMIT_MEMLOCK: mlockall(MCL_FUTURE) is in
                                         force. */
  AGNOCAST_HEAPHOOK_FULL = 7,       /**< AGNOCAST_HEAPHOOK_WINDOWS_MAX windows are in use. */
  AGNOCAST_HEAPHOOK_OS = 8,         /**< A system call failed for another reason: see errno. */
  AGNOCAST_HEAPHOOK_INTERNAL = 9    /**< The allocator did not start: a defect, or no memory at
                                         all. */
};

/** Which allocations come from the windows after attach. */
enum agnocast_heaphook_scope {
  AGNOCAST_HEAPHOOK_SCOPE_LOAN = 0, /**< Those of threads between enter and leave. */
  AGNOCAST_HEAPHOOK_SCOPE_ALL = 1   /**< All, except of threads between pause and resume. */
};

/** Flag of a window: the caller has mapped all of [base, base + length) PROT_NONE, and the hook
 *  may replace that mapping. Without the flag the hook maps the range piece by piece and only
 *  where it is free. Reserved addresses count against RLIMIT_MEMLOCK once the process locks its
 *  memory; pieces count when mapped. */
#define AGNOCAST_HEAPHOOK_WINDOW_RESERVED 1u
/** Flag of a window for add_window: from now on blocks come only from this window and later ones.
 *  Blocks in earlier windows stay until they are freed, and their memory is not used again. For
 *  readers that cannot map an earlier window. */
#define AGNOCAST_HEAPHOOK_WINDOW_FRESH 2u

/** One window. The caller keeps both descriptors and may close them: the hook duplicates them
 *  (close-on-exec). */
struct agnocast_heaphook_window {
  void* base;        /**< Fixed address, multiple of 2 MiB. */
  size_t length;     /**< Bytes, multiple of 2 MiB, not 0. The memfd is at least as large and
                          reads as zero. */
  int write_fd;      /**< O_RDWR descriptor of the memfd, mapped MAP_SHARED. */
  int read_fd;       /**< O_RDONLY descriptor of the same memfd: forked children map it
                          privately. */
  uint32_t flags;    /**< 0 or AGNOCAST_HEAPHOOK_WINDOW_RESERVED. */
  uint32_t reserved; /**< 0. */
};

/** Publishes a larger frontier to readers, with release order. The hook calls it with the number
 *  of the window and the bytes mapped from its base, *before* malloc returns any address beyond
 *  the old frontier. It runs in the allocating thread under the allocator's locks: it must not
 *  allocate, free, block or call the hook. Calls are serialised. */
typedef void (*agnocast_heaphook_grown)(void* context, uint32_t window, uint64_t frontier_bytes);

struct agnocast_heaphook_options {
  uint32_t scope;                /**< enum agnocast_heaphook_scope. */
  uint32_t reserved;             /**< 0. */
  agnocast_heaphook_grown grown; /**< Required. */
  void* context;                 /**< Passed to grown. */
};

/** A snapshot; other threads may change values between the reads of two fields. Bytes unless
 *  named otherwise. */
struct agnocast_heaphook_usage {
  uint32_t window_count;          /**< 0 while inert. */
  uint32_t next_window_wanted;    /**< 1 if one more window is allowed, and 75 % of the last
                                       one is used or a request did not fit: call
                                       add_window. */
  uint64_t length_bytes;          /**< Sum over the windows. */
  uint64_t used_bytes;            /**< High-water mark of the allocator. */
  uint64_t frontier_bytes;        /**< Mapped; used_bytes <= frontier_bytes <= length_bytes. */
  uint64_t live_bytes;            /**< In allocated blocks, rounded up to size classes. */
  uint64_t refused_bytes_max;     /**< Largest request that found no room since the last
                                       add_window. */
  uint64_t refused_count;         /**< Attempts in shared scope without room, except during
                                       purge and for more than the last window's length;
                                       operator new makes two. */
  uint64_t mapping_refused_count; /**< Failed growths, and failed mappings of a forked child:
                                       lock limit, address taken, descriptor closed by the
                                       program. */
  uint64_t punch_count;           /**< Ranges returned to the kernel. Grows inside purge
                                       only. */
  uint64_t punched_bytes;
  uint64_t internal_error_count; /**< If not 0, report it. The caller should poison the
                                      endpoint. */
};

/** Throws a C++ exception. Must not return. */
typedef void (*agnocast_heaphook_no_room)(void);

/** The functions of the hook. Thread-safe unless stated otherwise. None allocates from the
 *  windows. */
struct agnocast_heaphook_table {
  uint32_t abi_version; /**< AGNOCAST_HEAPHOOK_ABI_VERSION of the hook. */
  uint32_t size_bytes;  /**< sizeof(struct agnocast_heaphook_table) of the hook. */

  /** Activates the hook: maps the first piece of the first window, calls grown for it, starts the
   *  allocator (about 0.4 ms, some 16 MiB of private addresses of which little is touched) and
   *  registers fork handlers. Once per process; INVALID, OCCUPIED, LOCK_LIMIT and OS leave no
   *  mapping or descriptor, and the caller may try again. One caller at a time. */
  int (*attach)(const struct agnocast_heaphook_window* window,
                const struct agnocast_heaphook_options* options);

  /** Adds a window; its number is the previous window_count. One caller at a time. Errors as
   *  attach, and FULL. */
  int (*add_window)(const struct agnocast_heaphook_window* window);

  /** Make the calling thread allocate from the windows from enter to the matching leave. Nest; a
   *  few instructions; allowed while inert. */
  void (*enter)(void);
  void (*leave)(void);

  /** Make the calling thread allocate from libc between pause and resume, in any scope. Nest. */
  void (*pause)(void);
  void (*resume)(void);

  /** Returns how many allocations of the calling thread in shared scope found no room in the
   *  windows and went to libc. Only grows. Unchanged between two calls: all allocations in
   *  between are in the windows. */
  uint64_t (*spilled)(void);

  /** Sets the function that operator new of the calling thread calls in shared scope when the
   *  windows have no room; its nothrow forms return NULL then. With NULL, the default, both use
   *  libc's memory; malloc and its family always do. Returns the previous function. For a copy
   *  that is useless unless all of it is shared. */
  agnocast_heaphook_no_room (*on_no_room)(agnocast_heaphook_no_room no_room);

  /** Allocates size bytes from the windows in any scope of the thread: for allocators that call
   *  it explicitly, whichever library provides malloc. alignment is a power of two. Returns NULL
   *  if the windows have no room, while paused or inert, and in a forked child; never libc's
   *  memory. */
  void* (*allocate)(size_t alignment, size_t size);

  /** Frees a block in a window and returns 1. Returns 0 and does nothing for any other address. */
  int (*deallocate)(void* block);

  /** Returns 1 if an allocation by the calling thread would try the windows first, else 0. */
  int (*active)(void);

  /** Returns 1 if the address is in the mapped part of a window, else 0. A few instructions. Also
   *  valid in a forked child. */
  int (*owns)(const void* address);

  /** Returns the mapped bytes of a window, 0 for a number that is not in use. */
  uint64_t (*frontier)(uint32_t window);

  /** Returns the number of the oldest window that blocks come from: 0, or that of the last FRESH
   *  one. A thread that has a block of a FRESH window, its own or another thread's, sees its
   *  number here. */
  uint32_t (*first_window)(void);

  /** Fills in a snapshot. Takes allocator locks for live_bytes: do not call it while
   *  publishing. */
  void (*usage)(struct agnocast_heaphook_usage* usage);

  /** Returns the pages of all idle memory to the kernel (they then read as zero in every
   *  process). Returns the bytes of that memory. Costs one system call per 2 MiB, and page faults
   *  at the next use: call it after idle time, in a thread that no other thread waits for. Other
   *  threads continue; they cannot use idle memory meanwhile, so a large block may get a new
   *  address or find no room. Only purge returns pages. */
  uint64_t (*purge)(void);

  /** Returns the bytes that purge would return and that no allocation needed since the previous
   *  call: freed blocks count from the next call on. Blocks of 64 KiB and more are tracked
   *  exactly; for smaller ones each page taken for them counts as needed. Takes allocator locks
   *  and reads some hundred numbers: do not call it while publishing. One caller at a time. */
  uint64_t (*idle)(void);

  /** Returns next_window_wanted of usage, without a lock. */
  int (*window_wanted)(void);
};

/** Returns the table; static, the same for the life of the process. */
__attribute__((visibility("default"))) const struct agnocast_heaphook_table* agnocast_heaphook(
    void);

#ifdef __cplusplus
}
#endif

#endif /* AGNOCAST_ABI_HEAPHOOK_H */
