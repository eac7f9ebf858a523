// SPDX-License-Identifier: Apache-2.0
//
// AccessControl: what the rules of [[access]] mean for requests, and for the memory behind the
// topics.
//
// A process has one heap: a process that is told of one of its publishers is given all of its
// windows. So a rule about a topic holds for its messages only if the same users may subscribe to
// every topic of the publishing process. Three checks see to it:
//
//   a publisher    is created only with the readers that the process began with: the first
//   publisher
//                  decides, for the life of the process, because a reader that was given a window
//                  keeps it
//   a subscription is created only if its user may subscribe to every topic that the publishers'
//                  processes publish; that fails only after the rules were changed
//   a process that comes back has nothing that the rules in force forbid, or it is revoked
//
// Replies and requests of services are topics like any other.
#pragma once

#include <base/sockets/peer_identity.hpp>
#include <base/text/log.hpp>
#include <daemon/config/access.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/requests.hpp>

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::daemon {

class AccessControl {
 public:
  AccessControl(const std::vector<AccessRule>& rules, const Registry& registry, Log& log) noexcept
      : rules_(rules), registry_(registry), log_(log) {}

  /// Returns whether the process may create this endpoint. Errors: access_denied, readers_differ.
  [[nodiscard]] Result<void> check_endpoint(const PeerIdentity& who, ClientIndex client,
                                            const CreateRequest& request) const;
  /// Logs a warning if the users to whom the process gave its memory are not those who may
  /// subscribe now.
  void warn_of_other_readers(ClientIndex client);
  /// Returns what the process has although the rules in force forbid it, as a sentence; empty:
  /// nothing.
  std::string forbidden_endpoint(ClientIndex client, const PeerIdentity& identity) const;

 private:
  [[nodiscard]] Result<void> check_readers(ClientIndex client, std::string_view topic) const;
  [[nodiscard]] Result<void> check_publishers(const Subject& who, std::uint64_t domain,
                                              std::string_view topic) const;

  const std::vector<AccessRule>& rules_;
  const Registry& registry_;
  Log& log_;
};

}  // namespace agnocast::daemon
