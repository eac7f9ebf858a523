// SPDX-License-Identifier: Apache-2.0
//
// Observe: what is said on a connection that only looks (agnocast-ctl). The packets of wire.hpp, with
// these bodies; docs/control-plane.md, "Observers".
//
//   observer → daemon     body       answer              descriptors of the answer
//   observe               Observe    observed            board (read)
//   dump                  Dump       dump_daemon, then dump_process, dump_topic, dump_endpoint,
//                                    dump_user and dump_refusal, each as often as there is one, then dump_end;
//                                    a process brings its region (read) while it has one
//   revoke                Revoke     done (or refused: permission_denied, endpoint_gone)
//   read_journal          ReadJournal  journal_record as often as there is one, then journal_end
//   set_log_level         SetLogLevel  log_level_is (or refused: permission_denied)
//   ask_access            AskAccess  access_is of publishing, then of subscribing
//
// All packets of one dump carry its request id and were made in one turn of the daemon: together
// they are one moment. A dump and a journal come with several bodies to a packet, each behind its own
// header and as long as that says, up to answer_bytes_max and descriptor_count_max; descriptors belong
// to the bodies of the packet in their order. An observer has no index, no region and no endpoint, and
// is never announced.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/abi/wire.hpp>
#include <agnocast/abi/words.hpp>

#include <cstdint>
#include <type_traits>

namespace agnocast::abi::wire {

struct Observe {
  Header header;
  std::uint64_t fingerprint;
};
struct Observed {
  Header header;
  std::uint64_t fingerprint;
  std::uint64_t incarnation;
  std::uint64_t client_region_bytes;
};
/// With `waits`, the answer comes when the daemon's log is no longer at `seen` (DumpEnd::lsn of the last
/// one): when somebody has come, gone or changed. Another request of the observer takes its place.
struct Dump {
  Header header;
  std::uint64_t seen;
  std::uint32_t waits;            // 1: until then
  std::uint32_t without_regions;  // 1: processes come without their descriptors
};
/// Ends the membership of a living process as if it had died; it is told `revoked`.
struct Revoke {
  Header header;
  std::uint64_t client;
  std::uint64_t generation;
};
/// The newest records of the daemon's redo log, at most `count`, up to `last` (0: the newest). With
/// count 0 only the end is answered: how far the log is.
struct ReadJournal {
  Header header;
  std::uint64_t last;
  std::uint64_t count;
};
/// A number of LogLevel (syslog's); 0: change nothing, only say what it is. Until the daemon ends: its next life has what
/// the configuration says.
struct SetLogLevel {
  Header header;
  std::uint64_t level;
};
struct LogLevelIs {
  Header header;
  std::uint64_t level;
};
/// Who may publish and subscribe there, whether or not there is such a topic.
struct AskAccess {
  Header header;
  std::uint64_t domain;
  Name topic;
};
struct AccessIs {
  Header header;
  Kind kind;           // publisher: of publishing; subscription: of subscribing
  std::uint32_t line;  // of the rule that decides, in the configuration; 0: no rule speaks of it
  std::uint32_t everybody;   // 1: whoever may connect
  std::uint32_t rule_count;  // of the whole configuration
  Name pattern;              // of the rule
  char principals
      [512];  // who may, as written, separated by commas; ends with "..." if there are more
};
enum class JournalState : std::uint32_t {
  applied = 1,
  pending = 2,  // committed; its change may not be complete
  damaged = 3,  // what lies there is no record; only lsn means something
};
/// A process by name, while the daemon still knows it; no name otherwise, and pid 0 unless the record has it.
struct JournalProcess {
  std::uint32_t pid;
  std::uint32_t reserved;
  Name name;
};
struct JournalRecord {
  Header header;
  std::uint64_t lsn;
  std::uint64_t stamp_ns;  // CLOCK_MONOTONIC
  std::uint32_t type;      // journal::RecordType
  JournalState state;
  std::uint64_t argument[13];
  Name topic;               // what it is about; empty: no topic, or not known any more
  JournalProcess process;   // whose
  JournalProcess receiver;  // the process that is told of it, lets go of it, or reads
};
struct JournalEnd {
  Header header;
  std::uint64_t record_count;  // sent in this answer
  std::uint64_t oldest;        // lsn of the oldest record that is still there, 0: none
  std::uint64_t newest;
  std::uint64_t now_ns;  // the daemon's CLOCK_MONOTONIC
};
static_assert(sizeof(JournalRecord) <= packet_bytes_max);

/// What has happened since the first start of this incarnation: restarts do not begin anew.
struct DaemonCounters {
  std::uint64_t clients_registered;
  std::uint64_t clients_died;
  std::uint64_t clients_let_go;   // live, without a trace of their regions
  std::uint64_t clients_revoked;  // live, but their membership was ended from outside
  std::uint64_t clients_rejoined;
  std::uint64_t intents_rolled_back;
  std::uint64_t intents_rolled_forward;
  std::uint64_t intents_corrupt;
  std::uint64_t restarts;
  std::uint64_t clients_died_meanwhile;  // of those that died: while no daemon was there
  std::uint64_t requests_answered_again;
  std::uint64_t requests_refused;
  std::uint64_t connections_refused;
  std::uint64_t readers_withdrawn;     // a publisher served a subscription no more
  std::uint64_t readers_served_again;  // and again
  std::uint64_t readers_mute;          // subscriptions that nobody could ring any more
};
/// [limits] of the configuration.
struct DaemonLimits {
  std::uint64_t clients;
  std::uint64_t topics;
  std::uint64_t publishers_per_topic;
  std::uint64_t subscriptions_per_topic;
  std::uint64_t slots_per_publisher;
  std::uint64_t depth_max;
  std::uint64_t windows_per_process;
};
/// What one user has, or may have ([quota] of the configuration; 2^64-1: unlimited).
struct UserShare {
  std::uint64_t clients;
  std::uint64_t publishers;
  std::uint64_t subscriptions;
  std::uint64_t executors;
  std::uint64_t heap_bytes;
  std::uint64_t held_messages;
  std::uint64_t topics;
  std::uint64_t queued_bytes;      // what the daemon keeps for those who do not read
  std::uint64_t queued_seconds;    // how long already
  std::uint64_t dumps_per_second;  // answers at length, to observers
  std::uint64_t publishers_per_topic;     // in use: of the topic where it has most
  std::uint64_t subscriptions_per_topic;  // likewise
};
struct DumpDaemon {
  Header header;
  std::uint32_t version_major;
  std::uint32_t version_minor;
  std::uint32_t version_patch;
  std::uint32_t pid;
  std::uint32_t uid;
  std::uint32_t log_level;
  std::uint64_t incarnation;
  std::uint64_t uptime_ns;
  std::uint64_t arena_base;
  std::uint64_t arena_bytes;
  std::uint64_t window_bytes;
  std::uint64_t windows_used;
  std::uint64_t connections;  // observers not among them
  std::uint64_t observers;
  std::uint64_t kept_descriptors;      // that survive the daemon's death
  std::uint64_t kept_descriptors_max;  // 0: nobody keeps any
  DaemonCounters counters;
  DaemonLimits limits;
  UserShare quota;
};

/// How the daemon stands to a process.
enum class ProcessState : std::uint32_t {
  connected = 1,
  orphaned = 2,  // lives and maps its region, but its connection has ended
  dead = 3,      // has ended; others still have its memory
  revoked = 4,   // lives, but is no member any more; its place is kept until it ends
};
struct DumpProcess {
  Header header;
  std::uint64_t client;
  std::uint64_t generation;
  std::uint32_t pid;  // as the daemon sees it; 0 when it does not
  std::uint32_t uid;
  std::uint32_t gid;
  ProcessState state;
  std::uint64_t domain;
  std::uint64_t age_ns;     // since its hello
  std::uint64_t executors;  // one bit each
  std::uint64_t silent_executors;  // those that nobody can ring by datagram, as far as is known
  std::uint32_t window_count;
  std::uint32_t region_count;  // descriptors that came with this
  Announcement::Window window[window_count_max];
  std::uint64_t blocked_bytes;  // of the arena, by what lies there in this process
  Name name;
  Name blocked_by;  // the first of it, for people
};
struct DumpTopic {
  Header header;
  std::uint32_t topic;
  std::uint32_t reserved;
  std::uint64_t generation;
  std::uint64_t domain;
  std::uint64_t layout_hash;
  Name name;
  Name type;
};
struct DumpEndpoint {
  Header header;
  Kind kind;
  std::uint32_t topic;
  std::uint64_t index;
  std::uint64_t generation;
  std::uint64_t member;  // generation and state as the board has to say them; free: only its owner
                         // still has it
  std::uint64_t client;
  std::uint64_t client_generation;
  std::uint64_t qos;  // abi::Qos, packed
  std::uint64_t extent;
  std::uint64_t slot_count;      // publisher
  std::uint64_t first_sequence;  // publisher
  std::uint64_t quota;           // subscription
  std::uint64_t quota_of_others;  // subscription: of publishers of other users
  std::uint64_t executor;        // subscription
  Name node;
};
struct DumpUser {
  Header header;
  std::uint64_t uid;
  std::uint64_t connections;
  std::uint64_t observers;
  UserShare use;
};
/// What was refused, or several times the same; daemon/state/refusals.hpp says how many of them there are.
struct DumpRefusal {
  Header header;
  std::uint32_t code;  // Errc
  std::uint32_t uid;
  std::uint32_t pid;  // as the daemon sees it; 0 when it does not
  Kind kind;          // of what was to be created; 0: nothing of that kind
  std::uint64_t domain;
  std::uint64_t age_ns;  // of the last time
  std::uint64_t times;
  Name process_name;  // empty: it has not said hello
  Name topic;         // empty: it is about none
  Name why;
};
/// How many packets of each kind came before.
struct DumpEnd {
  Header header;
  std::uint64_t process_count;
  std::uint64_t topic_count;
  std::uint64_t endpoint_count;
  std::uint64_t user_count;
  std::uint64_t refusal_count;
  std::uint64_t lsn;  // of the newest record of the daemon's log
};

template <class Body>
inline constexpr bool travels =
    sizeof(Body) <=
    packet_bytes_max&& std::is_trivially_copyable_v<Body>&& std::is_standard_layout_v<
        Body>&& std::has_unique_object_representations_v<Body>;
static_assert(travels<Observe> && travels<Observed> && travels<Dump> && travels<DumpDaemon> &&
              travels<DumpProcess> && travels<DumpTopic> && travels<DumpEndpoint> &&
              travels<DumpUser> && travels<DumpEnd> && travels<Revoke> && travels<ReadJournal> &&
              travels<JournalRecord> && travels<JournalEnd> && travels<SetLogLevel> &&
              travels<LogLevelIs> && travels<AskAccess> && travels<AccessIs> &&
              travels<DumpRefusal>);

}  // namespace agnocast::abi::wire
