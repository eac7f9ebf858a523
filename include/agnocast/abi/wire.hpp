// SPDX-License-Identifier: Apache-2.0
//
// Wire: the packets between client and daemon. AF_UNIX, SOCK_SEQPACKET: one packet, one message,
// in order per connection.
//
// Every packet starts with a Header; the opcode determines its body, one fixed struct, and the
// number of its descriptors (for announcements, the body has that number). A request carries an
// id that its reply repeats; a client that lost the connection repeats the request with the same
// id, and the daemon executes it once. Numbers are in native byte order: both sides run on one
// host.
//
// docs/control-plane.md has the meaning and the order of the messages.
//
// clang-format off
//   client → daemon       body               answer              descriptors of the answer
//   hello                 Hello              welcome             board (read), region (write)
//   rejoin                Rejoin             rejoined            after the connection was lost
//   open_window           WindowRequest      window_opened       window (write), window (read)
//   bring_window          BringWindow        done                (comes with: window (write))
//   open_wait_set         WaitSetRequest     wait_set_opened     eventfd, datagram socket
//   create_publisher      CreateEndpoint     endpoint_created
//   create_subscription   CreateEndpoint     endpoint_created
//   leave                 Reference          done                stop taking or publishing
//   drained               Reference          done                nothing held, lines zeroed
//   unlinked              Unlinked           –                   rule RU: unmapped
//   blocked               Blocked            –                   a range of the arena is occupied
//   withdrawn             Withdrawn          –                   it no longer serves a subscription
//   callback_group        CallbackGroup      –                   an executor has it, or no longer
//   callback_thread       CallbackThread     –                   it spins an executor, or no longer
//   watch_graph           WatchGraph         graph_changed       graph table (read), if it is another
//   any request may be answered by `refused`
//   observe, dump,        for observers: see observe.hpp
//   revoke, read_journal,
//   set_log_level, ask_access
//
//   daemon → client, unasked
//   announce              Announcement       region (read), windows (read), doorbells: see body
//   window_announced      WindowAnnounced    window (read)
//   forget                Reference          a subscription has ended: detach it, send unlinked
//   orphaned              Orphaned           a publisher has ended: drain it, then send unlinked
//   kick                  Reference          run a reclamation scan of this publisher's queue
//   move_heap             MoveHeap           allocate elsewhere: a reader cannot map this window
//   notice                Notice             incompatible QoS, type mismatch, …
//   own                   Own                after rejoined: your endpoint, as the daemon knows it
//   region                Reference          after rejoined: a region that was announced to you
//   doorbells_renewed     DoorbellsRenewed   eventfd, datagram socket: a wait set's new doorbells
//   revoked               Refused            your session is over; the connection ends
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/abi/words.hpp>

#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace agnocast::abi::wire {

inline constexpr std::uint32_t version = 1;
// ROS limits a fully qualified name to 255 bytes in practice (rmw_topic_endpoint_info); type names
// are as long.
inline constexpr std::uint32_t name_bytes = 256;
// The largest body is two names and a dozen numbers; longer packets are invalid.
inline constexpr std::uint32_t packet_bytes_max = 1024;
// Long answers to observers: as many bodies per packet as fit, because each packet costs both
// sides a system call. With the kernel's header it is four pages.
inline constexpr std::uint32_t answer_bytes_max = 15 * 1024;
// Client region, eight windows, two doorbells. The kernel allows 253 (SCM_MAX_FD).
inline constexpr std::uint32_t descriptor_count_max = 1 + window_count_max + 2;

enum class Opcode : std::uint32_t {
  // client → daemon
  hello = 1,
  open_window = 2,
  open_wait_set = 3,
  create_publisher = 4,
  create_subscription = 5,
  leave = 6,
  drained = 7,
  unlinked = 8,
  // observer → daemon (observe.hpp)
  observe = 9,
  dump = 10,
  revoke = 12,
  read_journal = 13,
  set_log_level = 17,
  ask_access = 18,
  // client → daemon, again
  rejoin = 11,
  blocked = 15,
  bring_window = 16,
  withdrawn = 19,
  callback_group = 20,
  callback_thread = 21,
  watch_graph = 22,
  // daemon → client: answers
  welcome = 101,
  window_opened = 102,
  wait_set_opened = 103,
  endpoint_created = 104,
  done = 105,
  refused = 106,
  observed = 107,
  dump_daemon = 108,
  dump_process = 109,
  dump_topic = 110,
  dump_endpoint = 111,
  dump_user = 112,
  dump_end = 113,
  rejoined = 114,
  journal_record = 115,
  journal_end = 116,
  log_level_is = 117,
  access_is = 118,
  dump_refusal = 119,
  dump_callback_group = 120,
  dump_callback_thread = 121,
  dump_thread_executors = 122,
  graph_changed = 123,
  // daemon → client: unasked
  announce = 201,
  window_announced = 202,
  forget = 203,
  orphaned = 204,
  kick = 205,
  notice = 206,
  own = 207,
  region = 208,
  revoked = 209,
  move_heap = 211,
  doorbells_renewed = 212,
};

/// The object of a Reference or Unlinked. A region is everything that belongs to one process:
/// client region and windows.
enum class Kind : std::uint32_t { publisher = 1, subscription = 2, region = 3 };

//    0 opcode u32 · 4 bytes u32 (whole packet) · 8 request u64 (0: not an answer)
struct Header {
  Opcode opcode;
  std::uint32_t bytes;
  std::uint64_t request;
};
static_assert(sizeof(Header) == 16 && std::is_trivially_copyable_v<Header>);
/// Bit in the request id of a request repeated because the connection was lost before the answer;
/// the answer repeats the id without it. A process never reuses an id.
inline constexpr std::uint64_t asked_again = std::uint64_t{1} << 63;

/// NUL-terminated within its bytes; otherwise the packet is malformed.
struct Name {
  char text[name_bytes];
};

struct Hello {
  Header header;
  std::uint64_t fingerprint;
  std::uint64_t domain;  // ROS_DOMAIN_ID
  Name process_name;     // for diagnosis
};
struct Welcome {
  Header header;
  std::uint64_t fingerprint;
  std::uint64_t incarnation;
  std::uint64_t client;
  std::uint64_t client_generation;
  std::uint64_t arena_base;  // the planned arena, to be reserved PROT_NONE now
  std::uint64_t arena_bytes;
  std::uint64_t client_region_bytes;
};
/// A known process on a new connection. The socket identifies the process, not this packet.
struct Rejoin {
  Header header;
  std::uint64_t fingerprint;
  std::uint64_t incarnation;  // of the welcome
  std::uint64_t client;
  std::uint64_t client_generation;
};
struct Rejoined {
  Header header;
  std::uint64_t incarnation;
};
struct Reference {
  Header header;
  Kind kind;
  std::uint32_t topic;
  std::uint64_t index;
  std::uint64_t generation;
};
/// `seen`: number of packets of this connection that the client has read. It does not acknowledge
/// later announcements.
struct Unlinked {
  Header header;
  Kind kind;
  std::uint32_t topic;
  std::uint64_t index;  // of the endpoint; of the client for a region
  std::uint64_t generation;
  std::uint64_t seen;
};
/// An occupied range of the arena in this process: [base, base + bytes), whole window granules,
/// at most blocked_count_max of them. Sent before the first endpoint, and again after `rejoined`.
struct Blocked {
  Header header;
  std::uint64_t base;
  std::uint64_t bytes;
  Name what;  // for diagnosis
};
/// A publisher of the process stopped serving a subscription, or resumed. For the daemon's log
/// and flight recorder only.
struct Withdrawn {
  Header header;
  std::uint32_t topic;
  std::uint32_t why;        // abi::Withdrawal; none: it serves it again
  std::uint64_t publisher;  // its index, and generation
  std::uint64_t publisher_generation;
  std::uint64_t subscription;
  std::uint64_t subscription_generation;
  std::uint64_t bytes;  // of the publisher that the subscription holds
};
/// An executor of the process has a callback group, or no longer. Every connection begins without
/// any. `executor` is the number of the executor in its process, not the index of a wait set; an
/// executor that isolates its groups has one for each.
struct CallbackGroup {
  Header header;
  std::uint64_t executor;
  std::uint64_t group;      // its number in the process
  std::uint32_t is_there;   // 0: no longer
  std::uint32_t reentrant;  // 1: several of its callbacks may run at once
  Name node;                // fully qualified
  Name name;                // empty: it has none
};
/// A thread of the process runs callbacks of this executor, or no longer.
struct CallbackThread {
  Header header;
  std::uint64_t executor;
  std::uint32_t thread;    // gettid(2)
  std::uint32_t is_there;  // 0: no longer
};
/// Asks for the graph table (graph_table.hpp), and to be notified of its next change. The daemon answers
/// at once if its table is not `table`, otherwise when `changes` there is no longer `seen`. A further
/// request of the process replaces it.
struct WatchGraph {
  Header header;
  std::uint64_t table;  // 0: it has none
  std::uint64_t seen;   // GraphHeader::changes
};
/// `table`: differs from that of every other daemon process, and from 0.
struct GraphChanged {
  Header header;
  std::uint64_t table;
  std::uint64_t changes;
};
/// Requests the process's next heap window; `window` is its number, so that the daemon recognises
/// a repeated request.
struct WindowRequest {
  Header header;
  std::uint64_t window;
};
/// `first`: number of the first window of its window set. A reader maps a set completely or not
/// at all: a message lies in windows of one set only. When the first window of a set opens, the
/// process allocates from that one only.
struct WindowOpened {
  Header header;
  std::uint64_t window;
  std::uint64_t base;
  std::uint64_t bytes;
  std::uint64_t first;
};
/// A window that a previous agnocastd gave this process, with its content: it keeps its address
/// and its number. The only request with a descriptor: the window for writing, which no other
/// process has.
struct BringWindow {
  Header header;
  std::uint64_t window;
  std::uint64_t base;
  std::uint64_t bytes;
  std::uint64_t first;  // of its window set
};
struct WindowAnnounced {
  Header header;
  std::uint64_t client;
  std::uint64_t client_generation;
  std::uint64_t window;
  std::uint64_t base;
  std::uint64_t bytes;
  std::uint64_t first;  // of its window set
};
/// Asks the client to open window number `window`; ignored if it is open.
struct MoveHeap {
  Header header;
  std::uint64_t window;
};
struct WaitSetRequest {
  Header header;
  std::uint64_t wait_set;
};
/// Replaces the doorbells of a wait set.
struct DoorbellsRenewed {
  Header header;
  std::uint64_t wait_set;
};
/// Bit in CreateEndpoint::quota: a smaller quota for publishers of other users is acceptable.
inline constexpr std::uint64_t quota_or_less = std::uint64_t{1} << 63;
struct CreateEndpoint {
  Header header;
  QosWords qos;
  std::uint64_t layout_hash;
  std::uint64_t wait_set;  // of a subscription
  std::uint64_t quota;     // messages that a subscription holds at most
  std::uint64_t domain;    // 0: that of the hello; otherwise one more than a ROS_DOMAIN_ID
  Name topic;              // fully qualified, starts with a slash
  Name type;
  Name node;
};
struct EndpointCreated {
  Header header;
  std::uint32_t topic;
  std::uint32_t reserved;
  std::uint64_t index;
  std::uint64_t generation;
  std::uint64_t extent;
  std::uint64_t slot_count;
  std::uint64_t first_sequence;
};
/// Announces a publisher to a subscriber's process, or a subscription to a publisher's process.
/// Descriptors, in this order: the client region (always; a process that has it already closes
/// it), window_count windows (publisher), doorbell_count doorbells (subscription).
struct Announcement {
  Header header;
  Kind kind;
  std::uint32_t topic;
  std::uint64_t own_index;  // the endpoint of the receiving process that this is for
  std::uint64_t own_generation;
  std::uint64_t index;  // of the announced endpoint
  std::uint64_t generation;
  std::uint64_t client;  // its process
  std::uint64_t client_generation;
  std::uint64_t extent;
  QosWords qos;
  std::uint64_t first_sequence;  // publisher
  std::uint64_t wait_set;        // subscription: of its process
  std::uint32_t
      from_start;  // publisher: it joined after the subscription, which may miss no message of it
  std::uint32_t window_count;    // publisher
  std::uint32_t doorbell_count;  // subscription: 1 datagram socket, 2 eventfd (same user), then
                                 // datagram socket, 0 mute: it cannot be rung
  std::uint32_t uid;        // of its process, in the daemon's user namespace
  std::uint32_t same_user;  // 1: same uid and user namespace as the receiving process
  std::uint32_t reserved;
  std::uint64_t quota;  // messages of the publisher that the subscription may hold
  struct Window {
    std::uint64_t base;
    std::uint64_t bytes;
    std::uint64_t first;  // of its window set
  } window[window_count_max];
};
struct Orphaned {
  Header header;
  std::uint32_t topic;
  std::uint32_t reserved;
  std::uint64_t index;
  std::uint64_t generation;
  std::uint64_t final_head;  // 0: too many are dead; unread messages are lost, unmap it
};
struct Refused {
  Header header;
  std::uint32_t code;  // Errc
  std::uint32_t os_errno;
  Name text;  // the refused object, for diagnosis
};
struct Notice {
  Header header;
  std::uint32_t code;  // Errc
  Kind kind;
  std::uint32_t topic;
  QosPolicy policy;  // of qos_incompatible; otherwise none
  std::uint64_t index;
  std::uint64_t generation;
  Name text;
};
/// An endpoint of the rejoined process, as the daemon knows it.
struct Own {
  Header header;
  Kind kind;
  std::uint32_t topic;
  std::uint64_t index;
  std::uint64_t generation;
  std::uint64_t creation;  // id of the request that created it
  std::uint32_t active;    // 0: it has left
  std::uint32_t reserved;
};
struct Done {
  Header header;
};

static_assert(sizeof(CreateEndpoint) <= packet_bytes_max &&
              sizeof(Announcement) <= packet_bytes_max && sizeof(Hello) <= packet_bytes_max &&
              sizeof(CallbackGroup) <= packet_bytes_max &&
              sizeof(Notice) <= packet_bytes_max && sizeof(Own) <= packet_bytes_max);
static_assert(std::is_trivially_copyable_v<Announcement> &&
              std::is_standard_layout_v<Announcement>);
static_assert(std::has_unique_object_representations_v<Announcement> &&
                  std::has_unique_object_representations_v<Own>,
              "no hidden padding travels");

}  // namespace agnocast::abi::wire
