// SPDX-License-Identifier: Apache-2.0
//
// Steps of the client: places between two changes of the control plane that other processes see.
// Only the crash sweeps use them; one name may stand in several places. Steps in general:
// base/step.hpp.
#pragma once

#include <base/step.hpp>

#define AGNOCAST_CLIENT_STEPS(X)                                          \
  X(C_connect, "a socket is connected")                                   \
  X(C_hello, "say hello")                                                 \
  X(C_arena, "reserve the arena")                                         \
  X(C_regions, "map board and own region")                                \
  X(C_thread, "start the control thread")                                 \
  X(C_ask, "send a request to the daemon")                                \
  X(C_answer, "an answer has been read")                                  \
  X(C_send, "send a packet without an answer to the daemon")              \
  X(C_packet, "a packet of the daemon has been read")                     \
  X(C_window_described, "own region: a window's place")                   \
  X(C_window_open, "pass a window to the hook")                           \
  X(C_window_opened, "a window is in use")                                \
  X(C_extent_open, "map a new endpoint's extent")                         \
  X(C_registered, "a new endpoint enters the table")                      \
  X(C_wait_set, "a new wait set has its doorbells")                       \
  X(C_left, "leave was answered")                                         \
  X(C_closed, "a subscription is closed")                                 \
  X(C_release_last, "the release that a closing link waited for")         \
  X(C_peer_map, "map a peer's region")                                    \
  X(C_peer_window, "a peer's window becomes known")                       \
  X(C_peer_extent, "map a peer's extent")                                 \
  X(C_peer_open, "map a peer's window up to its frontier")                \
  X(C_peer_opened, "remember how far a peer's window is mapped")          \
  X(C_peer_cover, "unmap a peer's window")                                \
  X(C_peer_unmap, "unmap a peer")                                         \
  X(C_link, "link a publisher")                                           \
  X(C_linked, "a linked publisher enters the table")                      \
  X(C_attach, "attach a subscription")                                    \
  X(C_detach, "detach a subscription")                                    \
  X(C_orphaned, "a publisher publishes no more")                          \
  X(C_unlink, "unlink an ended publisher")                                \
  X(C_errand_ring, "ring a wait set that publish has deferred")           \
  X(C_publisher_over, "unmap everything that a publisher had attached")   \
  X(C_erased, "an endpoint leaves the table")                             \
  X(C_adopt, "adoption: copy the message into the shared heap")           \
  X(C_adopted, "adoption: the copy is made")                              \
  X(C_original, "adoption: the original is gone")                         \
  X(C_destroy, "destroy a message")                                       \
  X(C_reconnect, "the socket of the next connection is connected")        \
  X(C_rejoin, "send the identity of the previous connection")             \
  X(C_rejoined, "the connection may be used again")                       \
  X(C_revoked, "the session has ended")                                   \
  X(C_store_lost, "the daemon's store is lost")                           \
  X(C_next, "begin a new session")                                        \
  X(C_follow, "the heap follows another region")                          \
  X(C_bring, "bring a window along")                                      \
  X(C_brought, "a window is brought along")                               \
  X(C_present, "the new session becomes the current one")                 \
  X(C_place, "a wait set gets a place in the new session")                \
  X(C_successor, "a subscription's successor is made")                    \
  X(C_succeeded, "a subscription has a successor")                        \
  X(C_migration_successor, "a publisher's successor is made")             \
  X(C_inherit, "a successor inherits a message")                          \
  X(C_move, "a publisher moves to its successor")                         \
  X(C_moved, "a publisher has moved")                                     \
  X(C_redirect, "a publisher that had moved before points to the newest") \
  X(C_successor_leaves, "the successor of an ended publisher leaves")     \
  X(C_finish, "an endpoint of a previous session has ended")              \
  X(C_previous_end, "a previous session ends")

AGNOCAST_STEPS(client, 256, AGNOCAST_CLIENT_STEPS)
