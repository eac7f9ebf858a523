// SPDX-License-Identifier: Apache-2.0
//
// Steps of the data plane, numbered as in docs/protocol.md: publish (P), withdraw (E), keep-all
// (K), take (T), release (L), sleep (S), link (J6, J7), unlink (U). Steps in general:
// base/step.hpp.
#pragma once

#include <base/step.hpp>

#define AGNOCAST_DATAPLANE_STEPS(X)                                \
  /* publish */                                                    \
  X(P0_frontier, "store the grown frontier of a window")           \
  X(P1_sequence, "intent: sequence")                               \
  X(P1_slot, "intent: slot")                                       \
  X(P1_op, "intent: publishing")                                   \
  X(P2_address, "slot: address")                                   \
  X(P2_stamp, "slot: stamp")                                       \
  X(P2_size, "slot: size")                                         \
  X(P3_id, "slot: live")                                           \
  X(P4_order, "order ring entry")                                  \
  X(P5_head, "commit")                                             \
  X(P6_fence, "fence before reading the endpoints' words")         \
  X(P7_epoch, "load the epoch")                                    \
  X(P7_changed, "have the topic's endpoints changed?")             \
  X(P7_word, "load a subscription's state word")                   \
  X(P7_self, "load the publisher's own state word")                \
  X(P7_since, "lower bound of a new subscription's start")         \
  X(P7_seen, "remember the head of this epoch check")              \
  X(P7_match, "does the offer satisfy a subscription's request?")  \
  X(P7_reach, "how much a new subscription can ask for")           \
  X(P7_slots, "load the present number of slots")                  \
  X(P8_armed, "load a wait set's sleep word")                      \
  X(P8_asleep, "is it asleep and not rung yet?")                   \
  X(P8_rung, "remember the generation rung")                       \
  X(P8_ring, "ring")                                               \
  X(P9_linked, "is the subscription linked to this generation?")   \
  X(P9_cursor, "load the cursor")                                  \
  X(P9_hold, "load the hold bits")                                 \
  X(P9_unknown, "keep what an unmapped subscription may start at") \
  X(P10_needed, "may a subscription still ask for it?")            \
  X(P10_past, "have all subscriptions passed it?")                 \
  X(P10_marked, "was it retired before the fence?")                \
  X(P10_held, "does a subscription hold it?")                      \
  X(P10_free, "slot: free")                                        \
  X(P10_retire, "slot: retired")                                   \
  X(P11_idle, "intent: idle")                                      \
  X(E1_withdraw, "stop serving a subscription")                    \
  X(E2_clear, "has such a subscription released everything?")      \
  X(K0_room, "would a keep-all subscription be overrun?")          \
  /* take and release */                                           \
  X(T1_head, "load the head")                                      \
  X(T1_reach, "skip messages beyond the own depth")                \
  X(T2_order, "is the ring entry the one wanted?")                 \
  X(T3_live, "is the slot live before the hold?")                  \
  X(T4_hold, "publish the hold")                                   \
  X(T5_valid, "is the slot still live after the hold?")            \
  X(T5_withdrawn, "has the publisher stopped serving it?")         \
  X(T5_undo, "clear the hold again")                               \
  X(T6_frontier, "load the owner's frontiers and open up to them") \
  X(T6_inside, "is the message in an open window?")                \
  X(T7_cursor, "store the cursor")                                 \
  X(L1_release, "clear the hold")                                  \
  /* sleep */                                                      \
  X(S1_arm, "sleep word: about to sleep")                          \
  X(S2_fence, "fence before the re-check")                         \
  X(S5_disarm, "sleep word: awake")                                \
  /* link, unlink */                                               \
  X(J6_start, "load where the daemon let the link begin")          \
  X(J6_head, "load the head that the link starts from")            \
  X(J6_history, "does a late joiner get history?")                 \
  X(J6_cursor, "link line: cursor")                                \
  X(J6_generation, "link line: generation")                        \
  X(J6_check, "is the publisher still the announced one?")         \
  X(J7_member, "remember the line of a newly mapped subscription") \
  X(J7_rung, "forget the generation rung for this wait set index") \
  X(J7_ring, "ring a newly mapped subscription once")              \
  X(U1_generation, "unlink: generation")                           \
  X(U2_cursor, "unlink: cursor")

AGNOCAST_STEPS(dataplane, 0, AGNOCAST_DATAPLANE_STEPS)
