// SPDX-License-Identifier: Apache-2.0
//
// Steps of the daemon: places between two changes that others see. Only the crash sweeps use them;
// one name may stand in several places. What a step is: base/step.hpp.
#pragma once

#include <base/step.hpp>

#define AGNOCAST_DAEMON_STEPS(X)                                      \
  /* between its journaled changes */                                 \
  X(B_accepted, "a connection is accepted")                           \
  X(B_request, "a request is read")                                   \
  X(B_send, "hand a packet to the socket")                            \
  X(B_sent, "a packet is handed over")                                \
  X(B_ended, "a connection has ended")                                \
  X(B_reap, "a process has died")                                     \
  X(B_reaped, "a process's death is handled")                         \
  X(B_revoke, "end the session of a process that lives")              \
  X(B_recover, "repair a dead publisher's queue")                     \
  X(B_region_made, "a client region exists, without memory")          \
  X(B_region_sign, "write a client region's header")                  \
  X(B_window_base, "addresses of a window are taken")                 \
  X(B_window_made, "a window exists")                                 \
  X(B_clear, "clear an extent")                                       \
  X(B_back, "back an extent with memory")                             \
  X(B_head, "write a new publisher's head")                           \
  X(B_doorbell_bind, "bind a doorbell")                               \
  X(B_doorbell_bound, "a doorbell is bound")                          \
  X(B_doorbell_remove, "remove a doorbell's name")                    \
  X(B_doorbells_closed, "a dead process's doorbells are gone")        \
  X(B_ring, "ring a subscription of a publisher that is gone")        \
  X(B_memory_closed, "the daemon has closed a dead process's memory") \
  X(B_vacate, "free an unused place")                                 \
  X(B_place_free, "give back a process's region and addresses")       \
  X(B_keep, "store a descriptor")                                     \
  X(B_kept, "a descriptor is stored")                                 \
  X(B_drop, "remove a stored descriptor")                             \
  X(B_dropped, "a stored descriptor is removed")                      \
  /* inside a journaled change */                                     \
  X(B_name, "tables: a name in a free place")                         \
  X(B_table, "tables: the next number")                               \
  X(B_notified, "tables: the next announce set")

AGNOCAST_STEPS(daemon, 512, AGNOCAST_DAEMON_STEPS)
