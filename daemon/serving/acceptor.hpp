// SPDX-License-Identifier: Apache-2.0
//
// Acceptor: accepts connections, or refuses them with a reason.
//
// It answers a refused connection before closing it. When no descriptor is left, it closes a spare
// one for a moment so that it can answer; then it accepts nothing until the next look_around().
#pragma once

#include <base/descriptors/unique_fd.hpp>
#include <base/sockets/packet_socket.hpp>
#include <base/sockets/peer_identity.hpp>
#include <base/text/log.hpp>
#include <daemon/admission/admission.hpp>
#include <daemon/config/config.hpp>
#include <daemon/serving/request_scheduler.hpp>
#include <daemon/serving/user_namespaces.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/dispatcher.hpp>
#include <daemon/transport/disposal.hpp>
#include <daemon/transport/listener.hpp>

#include <cstdint>

namespace agnocast::daemon {

/// The parts of the daemon that Acceptor needs.
struct AcceptorParts {
  const Config::Quota& quota;
  const Listener& listener;
  Dispatcher& dispatcher;
  Disposal& disposal;
  Registry& registry;
  const Admission& admission;
  ConnectionTable& connections;
  RequestScheduler& scheduler;
  UserNamespaces& namespaces;
  Log& log;
};

class Acceptor {
 public:
  explicit Acceptor(const AcceptorParts& parts);
  ~Acceptor();
  Acceptor(const Acceptor&) = delete;
  Acceptor& operator=(const Acceptor&) = delete;

  /// Begins to listen. Errors: os_failure.
  [[nodiscard]] Result<void> start();
  /// Accepts some of the waiting connections, if the dispatcher has found any.
  void accept_some();
  /// Returns whether it does not listen, for lack of a descriptor.
  bool pauses() const noexcept { return !listens_; }
  void listen_again();

 private:
  void pause_listening();
  void accept(PacketSocket socket);
  void refuse_over_quota(PacketSocket socket, const PeerIdentity& identity);
  /// Watches the connection and its process. `only_observes`: it cannot become a client.
  void attach(PacketSocket socket, PeerIdentity identity, bool only_observes);
  /// Accepts one connection although no descriptor is left, and refuses it with the reason.
  void turn_away();
  void close(PacketSocket socket, std::uint32_t uid);

  AcceptorParts of_;
  UniqueFd spare_;  // closed for a moment when no descriptor is left
  Dispatcher::Token listening_ = 0;
  bool listens_ = true;
  bool knocks_ = false;  // a connection waits to be accepted
};

}  // namespace agnocast::daemon
