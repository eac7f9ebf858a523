// SPDX-License-Identifier: Apache-2.0
//
// jemalloc's environment inside the hook: its configuration, and replacements of system
// functions.
//
// jemalloc reads MALLOC_CONF, /etc/malloc.conf and a symbol. A user's settings for another
// jemalloc must not affect a library in every process, so the first two appear to be absent and
// the symbol is ours.

#include "jemalloc_inert.hpp"

#include "shared_heap.hpp"

#include <errno.h>

extern "C" {

// narenas:1            arena 0, private, for metadata; the shared arena is created beside it
// *_decay_ms:-1        only purge() returns pages, never a timer or free
// background_thread    starts nothing
// oversize_threshold:0 no extra arena for large blocks: it would not be the shared one
// lg_extent_max_.._fit 64 = any idle extent may be split for a small request; the default of 6
//                      assumes that a timer purges large ones, and without one a new thread would
//                      take new memory beside them
// dss:disabled         no sbrk: the program break belongs to libc
// abort*:false         never ends the process for its own reasons
const char* agnocast_je_malloc_conf =
    "narenas:1,dirty_decay_ms:-1,muzzy_decay_ms:-1,background_thread:false,oversize_threshold:0,"
    "dss:disabled,"
    "lg_extent_max_active_fit:64,"
    "abort:false,abort_conf:false";

char* agnocast_je_secure_getenv(const char*) { return nullptr; }

ssize_t agnocast_je_readlink(const char*, char*, std::size_t) {
  errno = ENOENT;
  return -1;
}

// Only jemalloc's heap profiler, which is off, calls these. Defined here so that the hook needs
// neither libm nor libgcc_s.
double agnocast_je_exp(double) {
  return agnocast::heaphook::shared_heap::note_internal_error(), 1.0;
}
double agnocast_je_log(double) {
  return agnocast::heaphook::shared_heap::note_internal_error(), 0.0;
}
double agnocast_je_round(double value) {
  return agnocast::heaphook::shared_heap::note_internal_error(), value;
}
int agnocast_je__Unwind_Backtrace(void*, void*) {
  return agnocast::heaphook::shared_heap::note_internal_error(), 5;
}
std::size_t agnocast_je__Unwind_GetIP(void*) {
  return agnocast::heaphook::shared_heap::note_internal_error(), 0;
}
}
