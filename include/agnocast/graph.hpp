// SPDX-License-Identifier: Apache-2.0
//
// Graph: lists the publishers and subscriptions of this host in all domains, and reports changes:
// for bridges, recorders, tools. It reads a table that the daemon keeps in shared memory, so any
// number of processes may watch; it affects neither matching nor messages.
#pragma once

#include <agnocast/export.hpp>
#include <agnocast/qos.hpp>
#include <agnocast/result.hpp>

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace agnocast {

enum class EndpointKind : std::uint8_t { publisher, subscription };

/// One publisher or subscription.
struct EndpointInfo {
  EndpointKind kind = EndpointKind::publisher;
  std::uint64_t domain = 0;
  std::string topic;  ///< "/ns/name"; role_of_topic() tells the topics of services
  std::string type;   ///< "std_msgs/msg/String", or the name that the message type gives itself
  std::uint64_t layout_hash = 0;
  std::string node_name, node_namespace;  ///< "talker", "/ns"
  QoS qos{1};                             ///< as requested by the endpoint
  std::uint64_t generation = 0;  ///< never given twice while the daemon keeps its memory, also
                                 ///< over its restarts; for a publisher, equal to
                                 ///< MessageInfo::publisher of its messages
  std::uint32_t pid = 0;         ///< in the daemon's pid namespace; 0 if not visible there
  std::uint32_t uid = 0;
  std::uint64_t client = 0;  ///< of the process: the same for all its endpoints, and unique to it
  bool is_own = false;       ///< of this process
  std::string process_name;
};

/// The state at one moment, without the endpoints of dead processes, although others may still
/// read what those published.
struct GraphSnapshot {
  std::uint64_t incarnation =
      0;  ///< of the daemon's tables; if it differs, earlier snapshots are void
  std::vector<EndpointInfo> endpoints;  ///< by topic, publishers before subscriptions
  std::uint64_t missing = 0;            ///< endpoints that agnocastd had no room for, or no memory
};

/// Changes since the last look.
struct GraphChanges {
  std::uint64_t incarnation = 0;  ///< as in GraphSnapshot
  bool is_reset = false;          ///< what was known before is void: `added` is the whole state
  std::vector<EndpointInfo> added;
  std::vector<std::uint64_t> removed;  ///< generations
  std::uint64_t missing = 0;           ///< as in GraphSnapshot
};

/// One thread at a time. Beside one that waits another one may call look() and start_over(), and
/// any interrupt().
class AGNOCAST_PUBLIC Graph {
 public:
  /// Connects at the first wait(), as the first endpoint of the process does, or uses the
  /// connection that there is. One descriptor. Throws std::bad_alloc.
  Graph();
  ~Graph();
  Graph(Graph&&) noexcept;
  Graph& operator=(Graph&&) noexcept;

  /// The first call, and the first after an error, returns the present state. Later calls sleep
  /// until something changes and return the whole state again; changes within 10 ms are combined,
  /// also for longer where there are many endpoints, or many processes of one user that watch.
  /// Returns nothing if nothing has changed for `timeout`, or after interrupt(). Cost: reads all
  /// endpoints, a KiB each. Errors: daemon_not_running (no daemon for `timeout`; a restart in that
  /// time is no error); at once those of creating an endpoint: permission_denied, layout_mismatch,
  /// revoked, shut_down (a forked child) and others. Connecting may last five seconds more. The
  /// next call tries again.
  [[nodiscard]] Result<std::optional<GraphSnapshot>> wait(std::chrono::milliseconds timeout);
  /// The same, without reading: returns whether something has changed. For those that look().
  [[nodiscard]] Result<bool> wait_for_change(std::chrono::milliseconds timeout);
  /// Returns what is new since the last look, for those that keep the state themselves; nothing if
  /// nothing is, or if a wait has not brought the state of this daemon process yet. It asks nobody
  /// and does not sleep. While the connection lasts, the endpoints that this process has created
  /// are there, unless agnocastd has no room for them, and those whose end it has reported are not.
  /// Cost: a word of each endpoint, and a KiB of each new one. Throws std::bad_alloc; then the next
  /// look returns the whole state.
  [[nodiscard]] std::optional<GraphChanges> look();
  /// Lets the next look return the whole state: for those that could not keep the last one.
  void start_over() noexcept;
  /// Ends the present wait, or the next one. Any thread, any signal handler.
  void interrupt() noexcept;

 private:
  class State;
  std::unique_ptr<State> state_;
};

}  // namespace agnocast
