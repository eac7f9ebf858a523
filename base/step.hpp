// SPDX-License-Identifier: Apache-2.0
//
// The numbered steps of the protocol (docs/protocol.md), each with what it is. The crash sweep
// kills before each of them, the explorer leaves each of them out in turn, and both print these
// names.
#pragma once

#include <cstdint>

namespace agnocast {

#define AGNOCAST_STEP_TABLE(X)                                     \
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
  X(P6_fence, "fence before looking at anybody")                   \
  X(P7_epoch, "load the epoch")                                    \
  X(P7_changed, "has the membership changed?")                     \
  X(P7_word, "load a member's word")                               \
  X(P7_self, "load the own word")                                  \
  X(P7_since, "lower bound of where a new member starts")          \
  X(P7_seen, "remember the head of this epoch check")              \
  X(P7_match, "does the publisher offer what a member requests?")  \
  X(P7_window, "how much a new member can ask for")                \
  X(P7_slots, "how many slots there are now")                      \
  X(P8_armed, "load an executor's sleep word")                     \
  X(P8_asleep, "is it asleep and not rung yet?")                   \
  X(P8_rung, "remember the generation rung")                       \
  X(P8_ring, "ring")                                               \
  X(P9_linked, "is the member linked to this generation?")         \
  X(P9_cursor, "load the cursor")                                  \
  X(P9_hold, "load the hold bits")                                 \
  X(P9_unknown, "keep what an unmapped member may start at")       \
  X(P10_needed, "may somebody still ask for it?")                  \
  X(P10_past, "has everybody passed it?")                          \
  X(P10_marked, "was it retired before the fence?")                \
  X(P10_held, "does somebody hold it?")                            \
  X(P10_free, "slot: free")                                        \
  X(P10_retire, "slot: retired")                                   \
  X(P11_idle, "intent: idle")                                      \
  X(E1_withdraw, "tell a member that it gets nothing more")        \
  X(E2_clear, "has such a member let go of everything?")           \
  X(K0_room, "would a keep-all member be overrun?")                \
  /* take and release */                                           \
  X(T1_head, "load the head")                                      \
  X(T1_window, "skip what lies outside the own depth")             \
  X(T2_order, "is the ring entry the one wanted?")                 \
  X(T3_live, "is the slot live before the hold?")                  \
  X(T4_hold, "publish the hold")                                   \
  X(T5_valid, "is the slot still live after the hold?")            \
  X(T5_withdrawn, "does the publisher serve it no more?")          \
  X(T5_undo, "take the hold back")                                 \
  X(T6_frontier, "load the owner's frontiers and open up to them") \
  X(T6_inside, "does the message lie in an open window?")          \
  X(T7_cursor, "store the cursor")                                 \
  X(L1_release, "clear the hold")                                  \
  /* sleep */                                                      \
  X(S1_arm, "sleep word: about to sleep")                          \
  X(S2_fence, "fence before the re-check")                         \
  X(S3_news, "has something been published meanwhile?")            \
  X(S5_disarm, "sleep word: awake")                                \
  /* link, unlink */                                               \
  X(J6_head, "load the head the link starts from")                 \
  X(J6_history, "does a late joiner get history?")                 \
  X(J6_cursor, "link line: cursor")                                \
  X(J6_generation, "link line: generation")                        \
  X(J6_check, "is the publisher still the announced one?")         \
  X(J7_member, "remember where a newly mapped member's line is")   \
  X(J7_rung, "forget what the executor's number was rung for")     \
  X(J7_ring, "ring a newly mapped member once")                    \
  X(U1_generation, "unlink: generation")                           \
  X(U2_cursor, "unlink: cursor")                                   \
  /* the daemon's board */                                         \
  X(J3_descriptor, "board: descriptor of a new member")            \
  X(J3_word, "board: word of a new member")                        \
  X(J3_epoch, "board: epoch after a new member")                   \
  X(D2_word, "board: state of a subscription")                     \
  X(D2_epoch, "board: epoch after it")                             \
  X(D3_slot, "roll back: slot")                                    \
  X(D3_order, "roll back: order ring entry")                       \
  X(D3_intent, "recovered: intent idle")                           \
  X(D3_final_head, "board: final head")                            \
  X(D3_word, "board: publisher orphaned")                          \
  X(D3_epoch, "board: epoch after it")                             \
  X(D3_ring, "ring every subscription of the topic")               \
  /* the daemon's redo log */                                      \
  X(W1_record, "redo log: the record")                             \
  X(W2_committed, "redo log: committed")                           \
  X(W3_applied, "redo log: applied")                               \
  /* rule RU: who was told about a generation */                   \
  X(R1_tell, "journal: told, before the announcement is sent")     \
  X(R2_let_go, "journal: has let go")                              \
  X(R2_generation, "does the message speak of this generation?")   \
  X(R3_died, "journal: died")                                      \
  X(R4_reusable, "has everybody let go?")                          \
  X(R5_again, "was this generation unlinked before?")              \
  X(R6_link, "client: the generation is linked")                   \
  X(R7_unlinked, "client: the generation is unlinked")             \
  X(R8_again, "announce again to every member after a reconnect")

// Places between two changes of the control plane that others see. Only the crash sweeps use them;
// one name may stand in several places.
#define AGNOCAST_CONTROL_STEP_TABLE(X)                                      \
  /* client */                                                              \
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
  X(C_former_end, "a former membership ends")                               \
  /* daemon, between its journaled changes */                               \
  X(B_accepted, "a connection is accepted")                                 \
  X(B_request, "a request is read")                                         \
  X(B_send, "hand a packet to the socket")                                  \
  X(B_sent, "a packet is handed over")                                      \
  X(B_ended, "a connection has ended")                                      \
  X(B_reap, "a process has died")                                           \
  X(B_reaped, "a process's death is dealt with")                            \
  X(B_revoke, "end the membership of a process that lives")                 \
  X(B_recover, "repair a dead publisher's queue")                           \
  X(B_region_made, "a client region exists, without memory")                \
  X(B_region_sign, "a client region says whose it is")                      \
  X(B_window_base, "addresses of a window are taken")                       \
  X(B_window_made, "a window exists")                                       \
  X(B_clear, "clear an extent")                                             \
  X(B_back, "back an extent with memory")                                   \
  X(B_head, "write a new publisher's head")                                 \
  X(B_bell_bind, "bind a doorbell")                                         \
  X(B_bell_bound, "a doorbell is bound")                                    \
  X(B_bell_remove, "remove a doorbell's name")                              \
  X(B_bells_closed, "a dead process's doorbells are gone")                  \
  X(B_ring, "ring a subscription of a publisher that is gone")              \
  X(B_buried, "the daemon has let go of a dead process's memory")           \
  X(B_settle, "free what nobody has any more")                              \
  X(B_place_free, "give back a process's region and addresses")             \
  X(B_keep, "have a descriptor kept")                                       \
  X(B_kept, "a descriptor is kept")                                         \
  X(B_drop, "have a descriptor kept no longer")                             \
  X(B_dropped, "a descriptor is kept no longer")                            \
  /* daemon, inside a journaled change */                                   \
  X(B_name, "tables: a name in a free place")                               \
  X(B_table, "tables: the next number")                                     \
  X(B_told, "tables: the next set of who was told")                         \
  X(B_board_field, "board: the next word that is not its own step")

enum class Step : std::uint16_t {
#define AGNOCAST_STEP_ENUMERATOR(name, text) name,
  AGNOCAST_STEP_TABLE(AGNOCAST_STEP_ENUMERATOR)
      AGNOCAST_CONTROL_STEP_TABLE(AGNOCAST_STEP_ENUMERATOR)
#undef AGNOCAST_STEP_ENUMERATOR
          count
};

constexpr const char* name_of(Step step) noexcept {
  constexpr const char* names[] = {
#define AGNOCAST_STEP_NAME(name, text) #name,
      AGNOCAST_STEP_TABLE(AGNOCAST_STEP_NAME) AGNOCAST_CONTROL_STEP_TABLE(AGNOCAST_STEP_NAME)
#undef AGNOCAST_STEP_NAME
  };
  return step < Step::count ? names[static_cast<std::uint16_t>(step)] : "?";
}

constexpr const char* text_of(Step step) noexcept {
  constexpr const char* texts[] = {
#define AGNOCAST_STEP_TEXT(name, text) text,
      AGNOCAST_STEP_TABLE(AGNOCAST_STEP_TEXT) AGNOCAST_CONTROL_STEP_TABLE(AGNOCAST_STEP_TEXT)
#undef AGNOCAST_STEP_TEXT
  };
  return step < Step::count ? texts[static_cast<std::uint16_t>(step)] : "?";
}

#ifdef AGNOCAST_CRASH_POINTS
/// Tests only: may end this process with SIGKILL. See journal/crash_point.cpp.
void crash_point(Step name) noexcept;
#endif

/// In code that is no template over the memory policy: a place between two changes that others see.
/// May stand in several places under one name. Nothing in a build without crash points.
#ifdef AGNOCAST_CRASH_POINTS
#define AGNOCAST_CRASH_POINT(name) ::agnocast::crash_point(::agnocast::Step::name)
#else
#define AGNOCAST_CRASH_POINT(name) static_cast<void>(0)
#endif

}  // namespace agnocast
