// SPDX-License-Identifier: Apache-2.0
//
// System: the daemon's state at one moment, with the regions that belong to it mapped for reading.
//
// Everything in it was checked once: indexes are inside the tables, extents inside their regions,
// and regions long enough for their use. The contents of the regions belong to other processes and
// change all the time: copy each word once, and trust none.
#pragma once

#include <agnocast/abi/board.hpp>
#include <agnocast/abi/observe.hpp>
#include <base/memory/mapping.hpp>
#include <base/memory/memory_policy.hpp>
#include <base/sockets/answer_packet.hpp>
#include <base/sockets/packet_socket.hpp>
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
  /// The header and every extent in use; empty if the daemon had no region, or an invalid one (see
  /// `region_fault`).
  Mapping region;
  std::string region_fault;
  std::uint64_t publisher_count = 0, subscription_count = 0;
  // What this dump has; spins are pairs of a thread and an executor.
  std::uint64_t callback_group_count = 0, callback_thread_count = 0, callback_spin_count = 0;
  std::vector<std::uint32_t> topics;  // the topics of its endpoints, each index once

  bool owns(const Endpoint& endpoint) const noexcept;
};

struct Endpoint {
  wire::DumpEndpoint facts{};
  std::string node_name, node_namespace;

  abi::BoardState state() const noexcept { return abi::state_of(facts.board_word); }
  bool is_publisher() const noexcept { return facts.kind == wire::Kind::publisher; }
  /// Returns whether publishers count this subscription.
  bool takes_messages() const noexcept { return abi::takes_part(facts.board_word); }
};

struct Topic {
  wire::DumpTopic facts{};
  std::string name, type;
  std::vector<Endpoint> publishers, subscriptions;

  /// Returns the length of what one of its endpoints has in a region.
  std::uint64_t extent_bytes(const Endpoint& endpoint) const noexcept;
};

/// A callback group of an executor.
struct CallbackGroup {
  wire::DumpCallbackGroup facts{};
  std::string node_name, node_namespace;
  std::string name;  // empty: it has none
};

/// A thread that runs callbacks.
struct ThreadFacts {
  wire::DumpCallbackThread facts{};
  std::vector<std::uint64_t> executors;  // facts.executor_count of them, ascending
};

struct System {
  wire::DumpDaemon daemon{};
  std::map<std::uint64_t, Process> processes;  // by index
  std::map<std::uint32_t, Topic> topics;       // by index
  std::vector<wire::DumpUser> users;
  std::vector<wire::DumpRefusal> refusals;  // the oldest first
  // Empty unless the look asks for them. Their processes are in the dump.
  std::vector<CallbackGroup> callback_groups;  // by process, executor and number
  std::vector<ThreadFacts> callback_threads;   // by process and number, each once
  std::byte* board = nullptr;                  // the observer's

  /// Returns the process of an endpoint; nullptr if the dump names none.
  const Process* process_of(const Endpoint& endpoint) const;
  /// Returns whether, as far as the daemon knows, no publisher can ring this subscription.
  bool is_silent(const Endpoint& subscription) const;
  /// Returns the mapped region of the endpoint; nullptr if there is none.
  std::byte* region_of(const Endpoint& endpoint) const;
  region::TopicWords<SharedMemory> words_of(const Topic& topic) const noexcept {
    return {board, abi::topic_offset(topic.facts.topic)};
  }
  /// Returns how many messages of the publisher the subscription may hold.
  std::uint64_t hold_quota(const Endpoint& subscription, const Endpoint& publisher) const;
  /// Returns whether the board still shows this endpoint; then earlier reads of its extent count.
  bool is_still_there(const Topic& topic, const Endpoint& endpoint) const;
};

/// Returns "lidar (pid 812, uid 1000)".
std::string words_of(const Process& process);
/// Returns the same for the process of an endpoint; empty if the dump names none.
std::string process_words_of(const System& system, const Endpoint& endpoint);

/// Returns whether SIGSTOP or a debugger has stopped it, possibly in the middle of an operation.
/// Returns false if that cannot be known.
bool is_stopped(const wire::DumpProcess& process);

/// Returns whether its pid names the process in this pid namespace, as far as its user shows.
bool is_visible(const wire::DumpProcess& process);

struct LookOptions {
  bool threads = false;  // also callback groups and the threads that run them
};

/// An observer's connection to the daemon. Problems: not_reachable, permission_denied, failed.
class Observer {
 public:
  static Outcome<Observer> connect(const std::string& socket);
  /// Returns the system at one moment.
  Outcome<System> look(LookOptions options = {});
  /// Ends the session of a process. Problems also: no_such_thing.
  Outcome<void> revoke(const wire::DumpProcess& process);
  /// Returns at most `count` newest records of the daemon's log, up to `last` (0: the newest).
  Outcome<Journal> read_journal(std::uint64_t last, std::uint64_t count);
  /// Sets the daemon's log level (0: no change), returns it. Problems also: permission_denied.
  Outcome<std::uint64_t> log_level(std::uint64_t level);
  /// The rules for publishing and subscribing to a topic.
  struct Access {
    wire::AccessIs publish{}, subscribe{};
  };
  Outcome<Access> access(std::uint64_t domain, const std::string& topic);
  /// Returns the length of every client region.
  std::uint64_t region_bytes() const noexcept { return region_bytes_; }

 private:
  Observer(PacketSocket socket, std::string path);
  /// Returns the next body; the previous one is no longer valid.
  Outcome<AnswerPacket*> receive();
  Outcome<void> receive_packet();
  template <class Body>
  Outcome<void> send(wire::Opcode opcode, Body body);
  tl::unexpected<Problem> nonsense() const;
  tl::unexpected<Problem> without_descriptors() const;
  Outcome<void> accept(AnswerPacket& packet, System& system, wire::DumpEnd& seen) const;
  Outcome<void> accept_threads(AnswerPacket& packet, System& system, wire::DumpEnd& seen) const;
  Outcome<void> accept_group(AnswerPacket& packet, System& system) const;
  Outcome<void> accept_thread(AnswerPacket& packet, System& system) const;
  Outcome<void> accept_executors(AnswerPacket& packet, System& system) const;
  void map_regions(System& system) const;

  PacketSocket socket_;
  std::string path_;
  Mapping board_;
  std::uint64_t region_bytes_ = 0;
  std::unique_ptr<AnswerPacket> received_;
};

/// The connection and one system, enough for most commands. `observer` keeps the board mapped.
struct Look {
  Observer observer;
  System system;
};
Outcome<Look> look_at(const std::string& socket, LookOptions options = {});

}  // namespace agnocast::ctl
