// SPDX-License-Identifier: Apache-2.0
//
// Cases: the decisions of recovery. Tables of rows; a row has a label, a pattern over the facts
// found, and a decision. docs/recovery.md gives for each label the crash that causes it and the
// reason for the decision.
//
// Each fact is first reduced to a few kinds, one bit each; a pattern is a set of kinds for every
// fact. For every combination exactly one row matches (tests/unit/journal/recovery_table_test.cpp
// tries them all), so the order of the rows has no meaning. Combinations that no honest process
// and no crash can leave have rows as well.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace agnocast::journal {

inline constexpr std::uint8_t any = 0xff;

template <class Decision, std::size_t field_count>
struct CaseRow {
  const char* label;
  std::array<std::uint8_t, field_count> pattern;
  Decision decision;

  constexpr bool matches(const std::array<std::uint8_t, field_count>& found) const noexcept {
    for (std::size_t i = 0; i < field_count; ++i)
      if ((pattern[i] & found[i]) == 0) return false;
    return true;
  }
};

/// Returns the row for the facts; there always is one.
template <class Decision, std::size_t field_count, std::size_t row_count>
constexpr const CaseRow<Decision, field_count>& case_of(
    const CaseRow<Decision, field_count> (&rows)[row_count],
    const std::array<std::uint8_t, field_count>& found) noexcept {
  std::size_t i = 0;
  while (i + 1 < row_count && !rows[i].matches(found)) ++i;
  return rows[i];
}

// --- I: the intent of a publisher whose process is gone (queue_recovery.hpp)

enum class IntentDecision : std::uint8_t { nothing, roll_back, roll_forward, corrupt };

namespace intent {
// op · sequence against head · slot
inline constexpr std::uint8_t idle = 1, publishing = 2, unknown = 4;
inline constexpr std::uint8_t next = 1, committed = 2, elsewhere = 4;
inline constexpr std::uint8_t inside = 1, outside = 2;
using D = IntentDecision;
inline constexpr CaseRow<D, 3> rows[] = {
    {"@A", {idle, any, any}, D::nothing},
    {"@B", {publishing, next, inside}, D::roll_back},
    {"@C", {publishing, committed, any}, D::roll_forward},
    {"@D", {publishing, elsewhere, any}, D::corrupt},
    {"@E", {unknown, any, any}, D::corrupt},
    {"@F", {publishing, next, outside}, D::corrupt},
};
}  // namespace intent

// --- S: the meaning of a subscription for a message that its publisher may want to free. The
// reclamation scan (dataplane/publisher_core.hpp) decides; the test compares it with this table.

enum class RemainsDecision : std::uint8_t { keep, free };

namespace remains {
// the subscription's word on the board · its region mapped by the publisher · its line · hold bit
// · cursor
inline constexpr std::uint8_t active = 1, leaving = 2, over = 4;  // over: dead or free
inline constexpr std::uint8_t mapped = 1, unmapped = 2;
inline constexpr std::uint8_t linked = 1, unlinked = 2;
inline constexpr std::uint8_t held = 1, clear = 2;
inline constexpr std::uint8_t past = 1, unread = 2;
using D = RemainsDecision;
inline constexpr CaseRow<D, 5> rows[] = {
    {"@S1", {over, any, any, any, any}, D::free},
    {"@S2", {active, mapped, linked, held, any}, D::keep},
    {"@S3", {active, mapped, linked, clear, past}, D::free},
    {"@S4", {active, mapped, linked, clear, unread}, D::keep},
    {"@S5", {active, mapped, unlinked, any, any}, D::keep},
    {"@S6", {active, unmapped, any, any, any}, D::keep},
    {"@S7", {leaving, mapped, linked, held, any}, D::keep},
    {"@S8", {leaving, mapped, linked, clear, any}, D::free},
    {"@S9", {leaving, mapped, unlinked, any, any}, D::free},
    {"@S10", {leaving, unmapped, any, any, any}, D::keep},
};
}  // namespace remains

// --- L: the redo log at the start of a daemon

enum class LogDecision : std::uint8_t { go_on, redo, refuse_layout, refuse_damaged };

namespace log {
// magic · fingerprint and shape · committed against applied · the newest committed record
inline constexpr std::uint8_t ours = 1, none = 2;
inline constexpr std::uint8_t same = 1, other = 2;
inline constexpr std::uint8_t equal = 1, one_ahead = 2, impossible = 4;
inline constexpr std::uint8_t whole = 1, damaged = 2;
using D = LogDecision;
inline constexpr CaseRow<D, 4> rows[] = {
    {"@L1", {ours, same, equal, any}, D::go_on},
    {"@L2", {ours, same, one_ahead, whole}, D::redo},
    {"@L3", {ours, same, one_ahead, damaged}, D::refuse_damaged},
    {"@L4", {ours, same, impossible, any}, D::refuse_damaged},
    {"@L5", {ours, other, any, any}, D::refuse_layout},
    {"@L6", {none, any, any, any}, D::refuse_damaged},
};
}  // namespace log

// --- U: one announcement after the connection was lost. The daemon's action follows from the
// announce set, the client's from its announcement state (announce_set.hpp); the test runs both.

enum class AnnounceDecision : std::uint8_t { nothing, link, ignore, say_unlinked, impossible };

namespace announce {
// in the announce set · read by the client · the client's state for this generation
inline constexpr std::uint8_t notified = 1, unnotified = 2;
inline constexpr std::uint8_t delivered = 1, lost = 2;
inline constexpr std::uint8_t never = 1, linked = 2, unlinked = 4;
using D = AnnounceDecision;
inline constexpr CaseRow<D, 3> rows[] = {
    {"@U1", {unnotified, lost, never}, D::nothing},
    {"@U2", {notified, lost, never}, D::link},
    {"@U3", {notified, delivered, never}, D::link},
    {"@U4", {notified, delivered, linked}, D::ignore},
    {"@U5", {notified, delivered, unlinked}, D::say_unlinked},
    {"@U6", {unnotified, delivered, unlinked}, D::nothing},
    {"@U7", {unnotified, delivered, linked | never}, D::impossible},
    {"@U8", {any, lost, linked | unlinked}, D::impossible},
};
}  // namespace announce

// --- Q: a request, and its state in the tables. `again`: the client lost the connection before
// the answer.

enum class RequestDecision : std::uint8_t { carry_out, answer_as_before, say_done, refuse };

namespace request {
// kind of request · asked · in the tables
inline constexpr std::uint8_t create = 1, open_window = 2, open_wait_set = 4, leave = 8,
                              drained = 16;
inline constexpr std::uint8_t first = 1, again = 2;
// done: carried out before; used: and a later request used the answer, so the client has read it
inline constexpr std::uint8_t not_done = 1, done = 2, used = 4;
using D = RequestDecision;
inline constexpr CaseRow<D, 3> rows[] = {
    {"@Q1", {any, any, not_done}, D::carry_out},
    {"@Q2", {create, first, done | used}, D::carry_out},
    {"@Q3", {create, again, done | used}, D::answer_as_before},
    {"@Q4", {open_window, any, done | used}, D::answer_as_before},
    {"@Q5", {open_wait_set, again, done}, D::carry_out},
    {"@Q6", {open_wait_set, again, used}, D::refuse},
    {"@Q7", {leave | drained, again, done | used}, D::say_done},
    {"@Q8", {open_wait_set | leave | drained, first, done | used}, D::refuse},
};
}  // namespace request

constexpr RequestDecision decide_request(std::uint8_t what, bool asked_again,
                                         std::uint8_t in_tables) noexcept {
  return case_of(request::rows, {what, asked_again ? request::again : request::first, in_tables})
      .decision;
}

// --- J: a process that sends rejoin

enum class RejoinDecision : std::uint8_t {
  take_back,
  layout_mismatch,
  permission_denied,
  started_anew,
  revoked,
};

namespace rejoin {
// fingerprint · the process is the one that connected · incarnation · generation of its index ·
// state of its index (dead: its session has ended) · the process behind the stored pidfd
inline constexpr std::uint8_t same = 1, other = 2;
inline constexpr std::uint8_t alive = 1, dead = 2, free = 4;
using D = RejoinDecision;
inline constexpr CaseRow<D, 6> rows[] = {
    {"@J1", {same, same, same, same, alive, same}, D::take_back},
    {"@J2", {same, same, same, same, alive, other}, D::permission_denied},
    {"@J3", {same, same, same, same, dead, any}, D::revoked},
    {"@J4", {same, same, same, same, free, any}, D::started_anew},
    {"@J5", {same, same, same, other, any, any}, D::started_anew},
    {"@J6", {same, same, other, any, any, any}, D::started_anew},
    {"@J7", {same, other, any, any, any, any}, D::permission_denied},
    {"@J8", {other, any, any, any, any, any}, D::layout_mismatch},
};
}  // namespace rejoin

/// The facts known before the stored pidfd is checked; `take_back` is final only with that check.
struct RejoinFacts {
  bool same_layout = false;
  bool confirmed = false;
  bool same_incarnation = false;
  bool same_generation = false;
  std::uint8_t state = rejoin::free;
  bool same_process = false;
};
constexpr RejoinDecision decide_rejoin(const RejoinFacts& facts) noexcept {
  const auto bit = [](bool yes) { return yes ? rejoin::same : rejoin::other; };
  return case_of(rejoin::rows,
                 {bit(facts.same_layout), bit(facts.confirmed), bit(facts.same_incarnation),
                  bit(facts.same_generation), facts.state, bit(facts.same_process)})
      .decision;
}

// --- D: stored descriptors compared with the tables, at a start

enum class StoredDecision : std::uint8_t {
  take,           // use it
  remove,         // it has no owner any more
  make_anew,      // as on a first start
  start_anew,     // nothing else in the store is usable: begin a new incarnation
  owner_is_lost,  // treat its process as dead
  do_without,
};

namespace stored {
// kind · in the store · the record it belongs to
inline constexpr std::uint8_t tables = 1, listening = 2, memory = 4, process = 8, doorbell = 16,
                              unknown = 32;  // tables: board or redo log; memory: region or window
inline constexpr std::uint8_t present = 1, absent = 2;
inline constexpr std::uint8_t alive = 1, dead = 2, none = 4, revoked = 8;  // revoked: not yet ended
using D = StoredDecision;
inline constexpr CaseRow<D, 3> rows[] = {
    {"@D1", {tables, present, any}, D::take},
    {"@D2", {tables, absent, any}, D::start_anew},
    {"@D3", {listening, present, any}, D::take},
    {"@D4", {listening, absent, any}, D::make_anew},
    {"@D5", {memory, present, alive | dead | revoked}, D::take},
    {"@D6", {memory, absent, alive}, D::owner_is_lost},
    {"@D7", {memory, absent, dead}, D::do_without},
    {"@D8", {process, present, alive}, D::take},
    {"@D9", {process, absent, alive}, D::owner_is_lost},
    {"@D10", {doorbell, present, alive}, D::take},
    {"@D11", {doorbell, absent, alive}, D::do_without},
    {"@D12", {process | doorbell, present, dead}, D::remove},
    {"@D13", {memory | process | doorbell, present, none}, D::remove},
    {"@D14", {unknown, present, any}, D::remove},
    {"@D15", {process | doorbell, absent, dead}, D::do_without},
    {"@D16", {memory | process | doorbell, absent, none}, D::do_without},
    {"@D17", {unknown, absent, any}, D::do_without},
    {"@D18", {process, present, revoked}, D::take},
    {"@D19", {memory | process, absent, revoked}, D::owner_is_lost},
    {"@D20", {doorbell, present, revoked}, D::remove},
    {"@D21", {doorbell, absent, revoked}, D::do_without},
};
}  // namespace stored

constexpr StoredDecision decide_stored(std::uint8_t what, bool is_there,
                                       std::uint8_t owner) noexcept {
  return case_of(stored::rows, {what, is_there ? stored::present : stored::absent, owner}).decision;
}

// --- P: a process in the tables, at a start

enum class FoundDecision : std::uint8_t {
  expect,            // it has a session without a connection, and will send rejoin
  recover,           // it has ended: begin its reap
  finish,            // its reap was begun: repeat it
  finish_and_watch,  // likewise, and keep its index
  watch,             // only its index is left: keep it until the process ends
  settle,            // free its index when no process has anything of it
};

namespace found {
// state of the record · its reason · the process; "ended" if the daemon cannot watch it (D)
inline constexpr std::uint8_t alive = 1, dead = 2, forgotten = 4;
inline constexpr std::uint8_t gone = 1, revoked = 2;
inline constexpr std::uint8_t lives = 1, ended = 2;
using D = FoundDecision;
inline constexpr CaseRow<D, 3> rows[] = {
    {"@P1", {alive, any, lives}, D::expect},
    {"@P2", {alive, any, ended}, D::recover},
    {"@P3", {dead, gone, any}, D::finish},
    {"@P4", {dead, revoked, lives}, D::finish_and_watch},
    {"@P5", {dead, revoked, ended}, D::finish},
    {"@P6", {forgotten, gone, any}, D::settle},
    {"@P7", {forgotten, revoked, lives}, D::watch},
    {"@P8", {forgotten, revoked, ended}, D::settle},
};
}  // namespace found

constexpr FoundDecision decide_found(std::uint8_t state, bool is_revoked, bool lives) noexcept {
  return case_of(found::rows, {state, is_revoked ? found::revoked : found::gone,
                               lives ? found::lives : found::ended})
      .decision;
}

// --- C: a connection or its process has ended, or the daemon checks it once more

enum class EndDecision : std::uint8_t {
  drop,       // the connection had no session
  wait,       // the process stays without a connection
  recover,    // reap it
  free_place  // it was reaped when it was revoked: free its index
};

namespace end {
// the connection's process · whether it lives · whether it maps its region (maps: or unknown now)
inline constexpr std::uint8_t unknown = 1, client = 2, revoked = 4;
inline constexpr std::uint8_t lives = 1, ended = 2;
inline constexpr std::uint8_t maps = 1, unmapped = 2;
using D = EndDecision;
inline constexpr CaseRow<D, 3> rows[] = {
    {"@C1", {unknown, any, any}, D::drop},
    {"@C2", {client | revoked, lives, maps}, D::wait},
    {"@C3", {client, lives, unmapped}, D::recover},
    {"@C4", {client, ended, any}, D::recover},
    {"@C5", {revoked, lives, unmapped}, D::free_place},
    {"@C6", {revoked, ended, any}, D::free_place},
};
}  // namespace end

constexpr EndDecision decide_end(std::uint8_t whose, bool has_ended, bool has_unmapped) noexcept {
  return case_of(end::rows, {whose, has_ended ? end::ended : end::lives,
                             has_unmapped ? end::unmapped : end::maps})
      .decision;
}

// --- W: a window that its owner brings to a daemon with empty tables

enum class BroughtDecision : std::uint8_t {
  take,
  answer_as_before,
  protocol_violation,
  permission_denied,
  over_limit,  // window_exhausted or quota_exceeded
  arena_occupied,
};

namespace brought {
// its number · the base of the window with this number · its window set · room in the limits ·
// the descriptor · its place in the arena
inline constexpr std::uint8_t known = 1, next = 2, later = 4;
inline constexpr std::uint8_t same = 1, other = 2;
inline constexpr std::uint8_t possible = 1, impossible = 2;
inline constexpr std::uint8_t room = 1, full = 2;
inline constexpr std::uint8_t ours = 1, foreign = 2;
inline constexpr std::uint8_t free = 1, taken = 2;
using D = BroughtDecision;
inline constexpr CaseRow<D, 6> rows[] = {
    {"@W1", {known, same, any, any, any, any}, D::answer_as_before},
    {"@W2", {known, other, any, any, any, any}, D::protocol_violation},
    {"@W3", {later, any, any, any, any, any}, D::protocol_violation},
    {"@W4", {next, any, impossible, any, any, any}, D::protocol_violation},
    {"@W5", {next, any, possible, any, foreign, any}, D::permission_denied},
    {"@W6", {next, any, possible, full, ours, any}, D::over_limit},
    {"@W7", {next, any, possible, room, ours, taken}, D::arena_occupied},
    {"@W8", {next, any, possible, room, ours, free}, D::take},
};
}  // namespace brought

struct BroughtFacts {
  std::uint8_t number = brought::later;
  bool same_base = false;
  bool possible_window_set = false;
  bool room = false;
  bool ours = false;
  bool free = false;
};
constexpr BroughtDecision decide_brought(const BroughtFacts& facts) noexcept {
  return case_of(brought::rows,
                 {facts.number, facts.same_base ? brought::same : brought::other,
                  facts.possible_window_set ? brought::possible : brought::impossible,
                  facts.room ? brought::room : brought::full,
                  facts.ours ? brought::ours : brought::foreign,
                  facts.free ? brought::free : brought::taken})
      .decision;
}

// --- the texts of docs/recovery.md

constexpr const char* word_of(IntentDecision it) noexcept {
  constexpr const char* words[] = {"nothing", "roll_back", "roll_forward", "corrupt"};
  return words[static_cast<std::size_t>(it)];
}
constexpr const char* word_of(RemainsDecision it) noexcept {
  return it == RemainsDecision::keep ? "keep" : "free";
}
constexpr const char* word_of(LogDecision it) noexcept {
  constexpr const char* words[] = {"go_on", "redo", "refuse_layout", "refuse_damaged"};
  return words[static_cast<std::size_t>(it)];
}
constexpr const char* word_of(AnnounceDecision it) noexcept {
  constexpr const char* words[] = {"nothing", "link", "ignore", "say_unlinked", "impossible"};
  return words[static_cast<std::size_t>(it)];
}
constexpr const char* word_of(RequestDecision it) noexcept {
  constexpr const char* words[] = {"carry_out", "answer_as_before", "say_done", "refuse"};
  return words[static_cast<std::size_t>(it)];
}
constexpr const char* word_of(RejoinDecision it) noexcept {
  constexpr const char* words[] = {"take_back", "layout_mismatch", "permission_denied",
                                   "started_anew", "revoked"};
  return words[static_cast<std::size_t>(it)];
}
constexpr const char* word_of(FoundDecision it) noexcept {
  constexpr const char* words[] = {"expect",           "recover", "finish",
                                   "finish_and_watch", "watch",   "settle"};
  return words[static_cast<std::size_t>(it)];
}
constexpr const char* word_of(EndDecision it) noexcept {
  constexpr const char* words[] = {"drop", "wait", "recover", "free_place"};
  return words[static_cast<std::size_t>(it)];
}
constexpr const char* word_of(BroughtDecision it) noexcept {
  constexpr const char* words[] = {
      "take",       "answer_as_before", "protocol_violation", "permission_denied",
      "over_limit", "arena_occupied"};
  return words[static_cast<std::size_t>(it)];
}
constexpr const char* word_of(StoredDecision it) noexcept {
  constexpr const char* words[] = {"take",       "remove",        "make_anew",
                                   "start_anew", "owner_is_lost", "do_without"};
  return words[static_cast<std::size_t>(it)];
}

}  // namespace agnocast::journal
