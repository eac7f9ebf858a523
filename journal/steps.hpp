// SPDX-License-Identifier: Apache-2.0
//
// Steps of the daemon's changes to the board (J3, D2, D3) and to link lines (J4) and of its redo
// log (W); steps of rule RU, on both sides (R). Steps in general: base/step.hpp.
#pragma once

#include <base/step.hpp>

#define AGNOCAST_JOURNAL_STEPS(X)                                \
  /* the daemon's board */                                       \
  X(J3_descriptor, "board: descriptor of a new endpoint")        \
  X(J3_word, "board: word of a new endpoint")                    \
  X(J3_epoch, "board: epoch after a new endpoint")               \
  X(J4_head, "load the head behind which a subscription begins") \
  X(J4_start, "link line: where the subscription begins")        \
  X(D2_word, "board: state of a subscription")                   \
  X(D2_epoch, "board: epoch after it")                           \
  X(D3_slot, "roll back: slot")                                  \
  X(D3_order, "roll back: order ring entry")                     \
  X(D3_intent, "recovered: intent idle")                         \
  X(D3_final_head, "board: final head")                          \
  X(D3_word, "board: publisher orphaned")                        \
  X(D3_epoch, "board: epoch after it")                           \
  /* the daemon's redo log */                                    \
  X(W1_record, "redo log: the record")                           \
  X(W2_committed, "redo log: committed")                         \
  X(W3_applied, "redo log: applied")                             \
  /* rule RU: the processes notified about a generation */       \
  X(R1_tell, "redo log: notified, before the announcement")      \
  X(R2_unmapped, "redo log: unmapped")                           \
  X(R2_generation, "is the message about this generation?")      \
  X(R3_died, "redo log: died")                                   \
  X(R4_reusable, "have all processes unmapped it?")              \
  X(R5_again, "was this generation unlinked before?")            \
  X(R6_link, "client: the generation is linked")                 \
  X(R7_unlinked, "client: the generation is unlinked")           \
  /* inside a logged change */                                   \
  X(B_board_field, "board: the next word that is not its own step")

AGNOCAST_STEPS(journal, 128, AGNOCAST_JOURNAL_STEPS)
