// SPDX-License-Identifier: Apache-2.0
//
// Steps of the client: places between two changes of the control plane that others see. Only the
// crash sweeps use them; one name may stand in several places. What a step is: base/step.hpp.
#pragma once

#include <base/step.hpp>

#define AGNOCAST_CLIENT_STEPS(X)                                            \
  X(C_connect, "a socket is connected")                                     \
  X(C_hello, "say hello")                                                   \
  X(C_arena, "reserve the arena")                                           \
  X(C_regions, "map board and own region")                                  \
  X(C_thread, "start the control thread")                                   \
  X(C_ask, "ask the daemon for something")                                  \
  X(C_answer, "an answer has been read")                                    \
  X(C_post, "say something to the daemon")                                  \
  X(C_packet, "the daemon has said something")                              \
  X(C_window_described, "own region: a window's place")                     \
  X(C_window_open, "hand a window to the hook")                             \
  X(C_window_opened, "a window is in use")                                  \
  X(C_extent_open, "map a new endpoint's extent")                           \
  X(C_registered, "a new endpoint enters the table")                        \
  X(C_sleeper, "a new executor has its bells")                              \
  X(C_left, "leave was answered")                                           \
  X(C_closed, "a subscription is closed")                                   \
  X(C_release_last, "the release that a closing link waited for")           \
  X(C_peer_map, "map a peer's region")                                      \
  X(C_peer_window, "a peer's window becomes known")                         \
  X(C_peer_extent, "map a peer's extent")                                   \
  X(C_peer_open, "map what a peer's frontier shows")                        \
  X(C_peer_opened, "remember how far a peer's window is mapped")            \
  X(C_peer_cover, "unmap a peer's window")                                  \
  X(C_peer_unmap, "unmap a peer")                                           \
  X(C_link, "link a publisher")                                             \
  X(C_linked, "a linked publisher enters the table")                        \
  X(C_attach, "attach a subscription")                                      \
  X(C_detach, "detach a subscription")                                      \
  X(C_orphaned, "a publisher publishes no more")                            \
  X(C_unlink, "unlink what is over")                                        \
  X(C_errand_ring, "ring a sleeper that publish has left")                  \
  X(C_publisher_over, "let go of everything that a publisher had attached") \
  X(C_erased, "an endpoint leaves the table")                               \
  X(C_adopt, "adoption: copy the message into the shared heap")             \
  X(C_adopted, "adoption: the copy is made")                                \
  X(C_original, "adoption: the original is gone")                           \
  X(C_destroy, "destroy a message")                                         \
  X(C_reconnect, "the socket of the next connection is connected")          \
  X(C_rejoin, "say who this was")                                           \
  X(C_rejoined, "the connection may be used again")                         \
  X(C_revoked, "the membership is over")                                    \
  X(C_alone, "the daemon's store is lost")                                  \
  X(C_next, "begin another membership")                                     \
  X(C_follow, "the heap follows another region")                            \
  X(C_bring, "bring a window along")                                        \
  X(C_brought, "a window is brought along")                                 \
  X(C_present, "another membership becomes the present one")                \
  X(C_place, "a sleeper gets a place in another membership")                \
  X(C_successor, "a subscription's successor is made")                      \
  X(C_succeeded, "a subscription has a successor")                          \
  X(C_heir, "a publisher's heir is made")                                   \
  X(C_inherit, "an heir inherits a message")                                \
  X(C_move, "a publisher moves to its heir")                                \
  X(C_moved, "a publisher has moved")                                       \
  X(C_redirect, "a publisher that had moved before hands on to the newest") \
  X(C_heir_leaves, "the heir of a publisher that has ended leaves")         \
  X(C_finish, "an endpoint of a former membership is over")                 \
  X(C_former_end, "a former membership ends")

AGNOCAST_STEPS(client, 256, AGNOCAST_CLIENT_STEPS)
