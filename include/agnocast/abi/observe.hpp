// SPDX-License-Identifier: Apache-2.0
//
// Observe: the packets of a connection that only observes (agnocast-ctl): packets as in wire.hpp,
// with these bodies; docs/control-plane.md, "Observers".
//
//   observer → daemon     body       answer              descriptors of the answer
//   observe               Observe    observed            board (read)
//   dump                  Dump       dump_daemon, then each dump_process, dump_topic,
//                                    dump_endpoint, dump_user and dump_refusal, when asked for
//                                    each dump_callback_group and dump_callback_thread (with
//                                    its dump_thread_executors behind it), then dump_end; a
//                                    process comes with its region (read) while it has one
//   revoke                Revoke     done (or refused: permission_denied, endpoint_gone)
//   read_journal          ReadJournal  each journal_record, then journal_end
//   set_log_level         SetLogLevel  log_level_is (or refused: permission_denied)
//   ask_access            AskAccess  access_is of publishing, then of subscribing
//
// All packets of one dump carry its request id and are made in one time slice of the daemon:
// together they show one moment. A dump and a journal have several bodies per packet, each behind
// its own header with its length, up to answer_bytes_max and descriptor_count_max; descriptors
// belong to the bodies of the packet in their order. An observer has no index, no region and no
// endpoint, and is never announced.
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
struct Dump {
  Header header;
  std::uint64_t with_threads;  // 1: also callback groups and threads
};
/// Ends the session of a living process as if it had died; the daemon notifies it with `revoked`.
struct Revoke {
  Header header;
  std::uint64_t client;
  std::uint64_t generation;
};
/// Reads the newest records of the daemon's redo log, at most `count`, up to `last` (0: the
/// newest). With count 0 the answer has only the end: how far the log is.
struct ReadJournal {
  Header header;
  std::uint64_t last;
  std::uint64_t count;
};
/// Sets a LogLevel (syslog's numbers); 0 changes nothing and returns the level. It holds until
/// the daemon ends; the next one starts with the level of the configuration.
struct SetLogLevel {
  Header header;
  std::uint64_t level;
};
struct LogLevelIs {
  Header header;
  std::uint64_t level;
};
/// Asks for the access rule of a topic, which need not exist.
struct AskAccess {
  Header header;
  std::uint64_t domain;
  Name topic;
};
struct AccessIs {
  Header header;
  Kind kind;                 // publisher: for publishing; subscription: for subscribing
  std::uint32_t line;        // of the deciding rule in the configuration; 0: no rule applies
  std::uint32_t everybody;   // 1: every user that may connect
  std::uint32_t rule_count;  // of the whole configuration
  Name pattern;              // of the rule
  char principals[512];      // allowed users and groups, as written, separated by commas; "..." at
                             // the end: more
};
enum class JournalState : std::uint32_t {
  applied = 1,
  pending = 2,  // committed; its change may be incomplete
  damaged = 3,  // there is no valid record; only lsn has a meaning
};
/// A process's name, if the daemon still knows it; otherwise empty, with pid 0 unless the record
/// has it.
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
  Name topic;               // empty: none, or no longer known
  JournalProcess process;   // that the record belongs to
  JournalProcess receiver;  // the process that is notified, unmaps, or reads
};
struct JournalEnd {
  Header header;
  std::uint64_t record_count;  // sent in this answer
  std::uint64_t oldest;        // lsn of the oldest stored record, 0: none
  std::uint64_t newest;
  std::uint64_t now_ns;  // the daemon's CLOCK_MONOTONIC
};
static_assert(sizeof(JournalRecord) <= packet_bytes_max);

/// Counted since the first start of this incarnation; restarts do not reset them.
struct DaemonCounters {
  std::uint64_t clients_registered;
  std::uint64_t clients_died;
  std::uint64_t clients_unmapped;  // alive, without a trace of their regions
  std::uint64_t clients_revoked;   // alive, session ended from outside
  std::uint64_t clients_rejoined;
  std::uint64_t intents_rolled_back;
  std::uint64_t intents_rolled_forward;
  std::uint64_t intents_corrupt;
  std::uint64_t restarts;
  std::uint64_t clients_died_meanwhile;  // of those that died: while no daemon was running
  std::uint64_t requests_answered_again;
  std::uint64_t requests_refused;
  std::uint64_t connections_refused;
  std::uint64_t readers_withdrawn;     // a publisher stopped serving a subscription
  std::uint64_t readers_served_again;  // and resumed
  std::uint64_t readers_mute;          // subscriptions that became mute: no ring reaches them
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
/// The use of one user, or its limits ([quota] of the configuration; 2^64-1: unlimited).
struct UserShare {
  std::uint64_t clients;
  std::uint64_t publishers;
  std::uint64_t subscriptions;
  std::uint64_t wait_sets;
  std::uint64_t heap_bytes;
  std::uint64_t held_messages;
  std::uint64_t topics;
  std::uint64_t queued_bytes;             // queued by the daemon for clients that do not read
  std::uint64_t queued_seconds;           // age of that queue
  std::uint64_t dumps_per_second;         // long answers to observers
  std::uint64_t publishers_per_topic;     // in use: of the topic where it has most
  std::uint64_t subscriptions_per_topic;  // likewise
  std::uint64_t callback_groups;          // known to the daemon
  std::uint64_t callback_threads;         // likewise
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
  std::uint64_t connections;  // without observers
  std::uint64_t observers;
  std::uint64_t kept_descriptors;      // stored across the daemon's death
  std::uint64_t kept_descriptors_max;  // 0: there is no store
  DaemonCounters counters;
  DaemonLimits limits;
  UserShare quota;
};

/// State of a process as seen by the daemon.
enum class ProcessState : std::uint32_t {
  connected = 1,
  orphaned = 2,  // alive and mapping its region, but its connection has ended
  dead = 3,      // has ended; peers still map its memory
  revoked = 4,   // alive, but its session has ended; its index is kept until it ends
};
struct DumpProcess {
  Header header;
  std::uint64_t client;
  std::uint64_t generation;
  std::uint32_t pid;  // in the daemon's pid namespace; 0 if not visible there
  std::uint32_t uid;
  std::uint32_t gid;
  ProcessState state;
  std::uint64_t domain;
  std::uint64_t age_ns;            // since its hello
  std::uint64_t wait_sets;         // one bit each
  std::uint64_t silent_wait_sets;  // mute: no publisher can ring them by datagram, as far as known
  std::uint32_t window_count;
  std::uint32_t region_count;  // descriptors sent with this body
  Announcement::Window window[window_count_max];
  std::uint64_t blocked_bytes;     // of the arena, occupied by other mappings in this process
  std::uint64_t threads_left_out;  // callback groups and threads that the daemon does not know,
                                   // because of a limit or quota
  Name name;
  Name blocked_by;  // the first such mapping, for diagnosis
};
struct DumpTopic {
  Header header;
  std::uint32_t topic;
  std::uint32_t link_blocks;  // of each subscription; more than one: a wide topic
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
  std::uint64_t board_word;  // generation and state as the board must have them; free: only its
                             // owner still has it
  std::uint64_t client;
  std::uint64_t client_generation;
  QosWords qos;
  std::uint64_t extent;
  std::uint64_t slot_count;       // publisher
  std::uint64_t first_sequence;   // publisher
  std::uint64_t quota;            // subscription
  std::uint64_t quota_of_others;  // subscription: of publishers of other users
  std::uint64_t wait_set;         // subscription
  Name node;
};
struct DumpUser {
  Header header;
  std::uint64_t uid;
  std::uint64_t connections;
  std::uint64_t observers;
  UserShare use;
};
/// One refusal, or several equal ones; daemon/state/refusals.hpp has the limit of stored
/// refusals.
struct DumpRefusal {
  Header header;
  std::uint32_t code;  // Errc
  std::uint32_t uid;
  std::uint32_t pid;  // in the daemon's pid namespace; 0 if not visible there
  Kind kind;          // of the endpoint to create; 0: another request
  std::uint64_t domain;
  std::uint64_t age_ns;  // since the last time
  std::uint64_t times;
  Name process_name;  // empty: before its hello
  Name topic;         // empty: none
  Name why;
};
/// What CallbackGroup says of a group, and its process.
struct DumpCallbackGroup {
  Header header;
  std::uint64_t client;
  std::uint64_t client_generation;
  std::uint64_t executor;
  std::uint64_t group;
  std::uint32_t reentrant;
  std::uint32_t reserved;
  Name node;
  Name name;
};
/// What became of the thread settings for one thread.
enum class ThreadSetting : std::uint32_t {
  no_rule = 0,      // no rule of the configuration matches
  due = 1,          // the daemon is about to apply the rule
  applied = 2,      // as the kernel said
  not_allowed = 3,  // the rule is not for the user of the process
  refused = 4,      // by the kernel: os_errno of `call`
  not_found = 5,    // the daemon does not see this thread in the process
};
/// The system call that refused.
enum class ThreadCall : std::uint32_t { none = 0, sched_setattr = 1, sched_setaffinity = 2 };
/// The scheduling of a thread as sched_setattr(2) and sched_setaffinity(2) take it.
struct ThreadScheduling {
  std::uint32_t sets_policy;  // 1: policy, priority and the three times are set
  std::uint32_t policy;       // SCHED_OTHER, SCHED_FIFO, SCHED_RR, SCHED_BATCH, SCHED_IDLE or
                              // SCHED_DEADLINE
  std::uint32_t priority;     // of FIFO and RR
  std::uint32_t sets_nice;    // 1: nice is set
  std::int64_t nice;
  std::uint64_t runtime_ns;  // of DEADLINE
  std::uint64_t deadline_ns;
  std::uint64_t period_ns;
  std::uint64_t sets_cpus;  // 1: cpus is set
  std::uint64_t cpus[cpu_count_max / 64];
};
struct DumpCallbackThread {
  Header header;
  std::uint64_t client;
  std::uint64_t client_generation;
  std::uint32_t thread;  // as the process says: its own pid namespace
  std::uint32_t rule;    // line of the rule in the configuration; 0: no_rule
  ThreadSetting setting;
  ThreadCall call;         // of refused
  std::uint32_t os_errno;  // of refused
  std::uint32_t executor_count;
  ThreadScheduling scheduling;  // that the rule wants
};
/// Executors that the thread before spins: as many of these bodies as its executor_count needs.
inline constexpr std::uint32_t thread_executor_count_max = 64;
struct DumpThreadExecutors {
  Header header;
  std::uint64_t executor[thread_executor_count_max];
};
/// Number of packets of each kind in this dump.
struct DumpEnd {
  Header header;
  std::uint64_t process_count;
  std::uint64_t topic_count;
  std::uint64_t endpoint_count;
  std::uint64_t user_count;
  std::uint64_t refusal_count;
  std::uint64_t callback_group_count;
  std::uint64_t callback_thread_count;
  std::uint64_t thread_executors_count;
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
              travels<DumpRefusal> && travels<DumpCallbackGroup> && travels<DumpCallbackThread> &&
              travels<DumpThreadExecutors>);

}  // namespace agnocast::abi::wire
