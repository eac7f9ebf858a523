// SPDX-License-Identifier: Apache-2.0
//
// Record: one decision of the daemon in the redo log, and the meaning of its numbers.
//
// A record describes a change before the daemon makes it; redo_log.hpp stores records,
// daemon/state/registry_apply.cpp applies them. Some numbers are only for readers of the flight
// recorder: the owner of an endpoint, the reason of its end, the new value of a counter. Records
// about readers keep a uid and a pid, which stay valid after the index was given to another
// process.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>
#include <type_traits>

namespace agnocast::journal {

// X(name, number, names of the arguments in their order)
#define AGNOCAST_RECORD_TABLE(X)                                                              \
  X(none, 0, "")                                                                              \
  X(register_client, 1, "client generation uid gid pid domain registered_count")              \
  X(add_publisher, 2,                                                                         \
    "topic index generation client policies extent slot_count creation deadline_ns "          \
    "lifespan_ns lease_ns")                                                                   \
  X(add_subscription, 3,                                                                      \
    "topic index generation client policies extent quota wait_set creation quota_of_others "  \
    "deadline_ns lease_ns")                                                                   \
  X(announced, 4, "topic index to kind generation client to_generation")                      \
  X(unlinked, 5, "topic index by kind generation client by_generation")                       \
  X(leave_publisher, 6, "topic index final_head generation client cause intent_count")        \
  X(leave_subscription, 7, "topic index state generation client")                             \
  X(free_publisher, 8, "topic index state generation client")                                 \
  X(free_subscription, 9, "topic index generation client")                                    \
  X(client_dead, 10, "client generation reason death_count")                                  \
  X(client_end, 11, "client generation")                                                      \
  X(open_window, 12, "client window base bytes generation first")                             \
  X(add_topic, 15, "topic generation domain layout_hash link_blocks")                         \
  X(open_wait_set, 16, "client wait_set generation")                                          \
  X(free_topic, 17, "topic generation")                                                       \
  X(raise_slots, 18, "topic index slot_count generation client")                              \
  X(client_forgotten, 19, "client generation")                                                \
  X(readers, 22, "client set generation")                                                     \
  X(topic_forgotten, 23, "topic client generation")                                           \
  /* Change nothing but counters. */                                                          \
  X(recovered, 20, "pid redone_lsn dead_count board_word_count restart_count dead_total")     \
  X(rejoined, 21, "client generation rejoined_count")                                         \
  /* `client`, `uid`, `pid`: the process of the endpoint at `index`. */                       \
  X(reader_withdrawn, 24,                                                                     \
    "topic index generation client uid pid subscription reader_generation reader reader_uid " \
    "reader_pid why withdrawn_count")                                                         \
  X(reader_served_again, 25,                                                                  \
    "topic index generation client uid pid subscription reader_generation reader reader_uid " \
    "reader_pid served_again_count")                                                          \
  X(reader_mute, 26, "topic index generation client uid pid wait_set mute_count")

enum class RecordType : std::uint32_t {
#define AGNOCAST_RECORD_ENUMERATOR(name, number, arguments) name = number,
  AGNOCAST_RECORD_TABLE(AGNOCAST_RECORD_ENUMERATOR)
#undef AGNOCAST_RECORD_ENUMERATOR
};

/// Returns the name of a type; empty if there is no such type.
constexpr std::string_view name_of(RecordType type) noexcept {
  switch (type) {
#define AGNOCAST_RECORD_NAME(name, number, arguments) \
  case RecordType::name:                              \
    return #name;
    AGNOCAST_RECORD_TABLE(AGNOCAST_RECORD_NAME)
#undef AGNOCAST_RECORD_NAME
  }
  return {};
}

/// Returns the names of the arguments, separated by blanks.
constexpr std::string_view arguments_of(RecordType type) noexcept {
  switch (type) {
#define AGNOCAST_RECORD_ARGUMENTS(name, number, arguments) \
  case RecordType::name:                                   \
    return arguments;
    AGNOCAST_RECORD_TABLE(AGNOCAST_RECORD_ARGUMENTS)
#undef AGNOCAST_RECORD_ARGUMENTS
  }
  return {};
}

/// The life of an endpoint; `state` of its records.
///   publisher:      free → active → orphan → over → free
///   subscription:   free → active → leaving → over → free;  active, leaving → dead → free
enum class EndpointState : std::uint32_t {
  free = 0,
  active = 1,
  leaving = 2,  // subscription: takes no more, still holds
  orphan = 3,   // publisher: publishes no more, is being drained
  over = 4,     // publisher: all peers have unmapped it. subscription: its owner has
  dead = 5,     // subscription of a dead process
};

/// Why the session of a process has ended: `reason` of client_dead.
enum class DeathReason : std::uint64_t {
  died = 0,      // its pidfd is readable
  unmapped = 1,  // alive, but without a trace of its region: exec, or a shut library
  revoked = 2,   // alive, session ended from outside
};

/// Why a publisher has ended: `cause` of leave_publisher. The last four are decisions about the
/// intent of a dead process (queue_recovery.hpp).
enum class LeaveCause : std::uint64_t {
  left = 0,
  nothing_open = 1,
  rolled_back = 2,
  rolled_forward = 3,
  corrupt = 4,
};

inline constexpr std::size_t argument_count = 13;

//    0 lsn u64 · 8 type u32 · 12 crc32c u32 (of everything else) · 16 stamp_ns u64 CLOCK_MONOTONIC
//   24 argument[13] u64, meaning by type
struct Record {
  std::uint64_t lsn = 0;
  RecordType type = RecordType::none;
  std::uint32_t crc = 0;
  std::uint64_t stamp_ns = 0;
  std::uint64_t argument[argument_count] = {};
};
static_assert(sizeof(Record) == 128 && offsetof(Record, stamp_ns) == 16 &&
              offsetof(Record, argument) == 24 && std::is_trivially_copyable_v<Record>);
static_assert(std::has_unique_object_representations_v<Record>);

/// Returns the position of an argument in records of this type; argument_count: there is none.
constexpr std::size_t argument_index(RecordType type, std::string_view name) noexcept {
  std::string_view rest = arguments_of(type);
  for (std::size_t i = 0; !rest.empty(); ++i) {
    const std::size_t blank = rest.find(' ');
    if (rest.substr(0, blank) == name) return i;
    rest.remove_prefix(blank == std::string_view::npos ? rest.size() : blank + 1);
  }
  return argument_count;
}

}  // namespace agnocast::journal
