// SPDX-License-Identifier: Apache-2.0
//
// System: what the daemon says of one moment, with the regions that go with it, mapped for reading.
//
// Everything in it was checked once: indexes are inside the tables, extents inside their regions,
// regions as long as they are used. What the regions *say* is other processes' and changes all the
// time; whoever reads it copies it once and believes nothing.
#pragma once

#include <agnocast/abi/board.hpp>
#include <agnocast/abi/observe.hpp>
#include <base/answer_packet.hpp>
#include <base/mapping.hpp>
#include <base/memory_policy.hpp>
#include <base/packet_socket.hpp>
#include <ctl/cli/problem.hpp>
#include <ctl/snapshot/journal.hpp>
#include <region/views.hpp>

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace agnocast::ctl {

namespace wire = abi::wire;

struct Endpoint;

struct Process {
  wire::DumpProcess facts{};
  std::string name;
  std::string blocked_by;
  UniqueFd region_fd;
  /// The header and every extent that is in use; empty when the daemon had no region, or one that is
  /// not what it should be (`region_fault` says so).
  Mapping region;
  std::string region_fault;
  std::uint64_t publisher_count = 0, subscription_count = 0;
  std::vector<std::uint32_t> topics;  // where it has endpoints, each index once

  bool owns(const Endpoint& endpoint) const noexcept;
};

struct Endpoint {
  wire::DumpEndpoint facts{};
  std::string node_name, node_namespace;

  abi::MemberState state() const noexcept { return abi::state_of(facts.member); }
  bool is_publisher() const noexcept { return facts.kind == wire::Kind::publisher; }
};

struct Topic {
  wire::DumpTopic facts{};
  std::string name, type;
  std::vector<Endpoint> publishers, subscriptions;
};

struct System {
  wire::DumpDaemon daemon{};
  std::map<std::uint64_t, Process> processes;  // by index
  std::map<std::uint32_t, Topic> topics;       // by index
  std::vector<wire::DumpUser> users;
  std::vector<wire::DumpRefusal> refusals;  // the oldest first
  std::byte* board = nullptr;               // the observer's

  /// The process of an endpoint; nothing when the daemon's dump names none.
  const Process* process_of(const Endpoint& endpoint) const;
  /// Can nobody ring this subscription, as far as the daemon knows?
  bool is_silent(const Endpoint& subscription) const;
  /// Its mapped region; nullptr when there is none.
  std::byte* region_of(const Endpoint& endpoint) const;
  region::TopicWords<SharedMemory> words_of(const Topic& topic) const noexcept {
    return {board, abi::topic_offset(topic.facts.topic)};
  }
  /// How many messages of the publisher the subscription may hold.
  std::uint64_t hold_quota(const Endpoint& subscription, const Endpoint& publisher) const;
  /// Does the board still show this endpoint? What was read of its extent before is its own then.
  bool is_still_there(const Topic& topic, const Endpoint& endpoint) const;
};

/// "lidar (pid 812, uid 1000)".
std::string words_of(const Process& process);
/// The same of the process of an endpoint; empty when the daemon's dump names none.
std::string process_words_of(const System& system, const Endpoint& endpoint);

/// Is it held by SIGSTOP or a debugger? Such a process may stand in the middle of anything for any
/// time. False as well when it cannot be known.
bool is_stopped(const wire::DumpProcess& process);

/// A connection that looks. Problems: not_reachable, permission_denied, failed.
class Observer {
 public:
  static Outcome<Observer> connect(const std::string& socket);
  /// One moment.
  Outcome<System> look();
  /// Ends the membership of a process. Problems also: no_such_thing.
  Outcome<void> revoke(const wire::DumpProcess& process);
  /// The newest records of the daemon's log, at most `count`, up to `last` (0: the newest).
  Outcome<Journal> read_journal(std::uint64_t last, std::uint64_t count);
  /// What the daemon logs; `level` 0 changes nothing. Problems also: permission_denied.
  Outcome<std::uint64_t> log_level(std::uint64_t level);
  /// Who may publish and subscribe there.
  struct Access {
    wire::AccessIs publish{}, subscribe{};
  };
  Outcome<Access> access(std::uint64_t domain, const std::string& topic);
  /// How long every client region is.
  std::uint64_t region_bytes() const noexcept { return region_bytes_; }

 private:
  Observer(PacketSocket socket, std::string path);
  /// The next body; what the last one was is gone.
  Outcome<AnswerPacket*> receive();
  Outcome<void> receive_packet();
  template <class Body>
  Outcome<void> send(wire::Opcode opcode, Body body);
  tl::unexpected<Problem> nonsense() const;
  tl::unexpected<Problem> without_descriptors() const;
  Outcome<void> accept(AnswerPacket& packet, System& system, wire::DumpEnd& seen) const;
  void map_regions(System& system) const;

  PacketSocket socket_;
  std::string path_;
  Mapping board_;
  std::uint64_t region_bytes_ = 0;
  std::unique_ptr<AnswerPacket> received_;
};

/// Connects and looks once: what most commands need. `observer` keeps the board.
struct Look {
  Observer observer;
  System system;
};
Outcome<Look> look_at(const std::string& socket);

}  // namespace agnocast::ctl
