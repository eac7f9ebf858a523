// SPDX-License-Identifier: Apache-2.0
//
// Graph: who publishes and subscribes what on this host, in all domains, and being told when that changes:
// for bridges, recorders, tools. It looks on a connection of its own and takes part in nothing: neither
// matching nor anybody's messages change.
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
  std::string topic;  ///< "/ns/name"; whether it is one of a service, says role_of_topic()
  std::string type;   ///< "std_msgs/msg/String", or whatever its message type calls itself
  std::uint64_t layout_hash = 0;
  std::string node_name, node_namespace;  ///< "talker", "/ns"
  QoS qos{1};                             ///< as the endpoint asked for it
  std::uint64_t generation =
      0;                  ///< never the same for two of one incarnation; of a publisher it is
                          ///< MessageInfo::publisher of its messages
  std::uint32_t pid = 0;  ///< as the daemon sees it; 0 when it does not
  std::uint32_t uid = 0;
  std::uint64_t client =
      0;  ///< of the process: the same for all its endpoints, and no other process's
  std::string process_name;
};

/// One moment. Endpoints whose process is gone are not in it, although others may still read what they
/// published.
struct GraphSnapshot {
  std::uint64_t incarnation =
      0;  ///< of the daemon's tables; another one: nothing said before is true
  std::vector<EndpointInfo> endpoints;  ///< topic by topic, publishers before subscriptions
};

/// Not for two threads at once, but for interrupt(). A forked child has none.
class AGNOCAST_PUBLIC Graph {
 public:
  /// Connects when it is first asked. The socket is $AGNOCAST_SOCKET, or where the daemon listens.
  Graph();
  ~Graph();
  Graph(Graph&&) noexcept;
  Graph& operator=(Graph&&) noexcept;

  /// The first time, and after an error: what there is now. From then on it sleeps until something has
  /// changed, and says everything again; what happens within 10 ms comes together. Nothing when nothing has
  /// changed for `patience`, or after interrupt(). Errors: daemon_not_running (nobody there for `patience`; one
  /// that is started again meanwhile is no error), permission_denied, layout_mismatch and whatever else the
  /// daemon refuses, at once; protocol_violation. After one it may be asked again: it connects anew.
  [[nodiscard]] Result<std::optional<GraphSnapshot>> wait(std::chrono::milliseconds patience);
  /// Ends the present wait(), or the next one. Any thread, also a signal's handler.
  void interrupt() noexcept;

 private:
  class State;
  std::unique_ptr<State> state_;
};

}  // namespace agnocast
