// SPDX-License-Identifier: Apache-2.0
//
// AccessControl: applies the rules of [[access]] to requests, and to the memory behind the topics.
//
// A process has one heap: a process that is notified of one of its publishers gets all of its
// windows. So a rule about a topic holds for its messages only if the same users may subscribe to
// every topic of the publishing process. Three checks see to it:
//
// - A publisher is created only if its readers are those of the process's first publisher: that
//   one decides for the life of the process, because a reader keeps the windows it got.
// - A subscription is created only if its user may subscribe to every topic that the publishers'
//   processes publish; that fails only after the rules were changed.
// - A process that comes back has nothing that the current rules forbid, or it is revoked.
//
// Replies and requests of services are topics like any other.
#pragma once

#include <base/sockets/peer_identity.hpp>
#include <base/text/log.hpp>
#include <daemon/config/access.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/request_reading.hpp>

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::daemon {

Subject subject_of(const PeerIdentity& identity);

class AccessControl {
 public:
  AccessControl(const std::vector<AccessRule>& rules, const Registry& registry, Log& log) noexcept
      : rules_(rules), registry_(registry), log_(log) {}

  /// Checks that the process may create this endpoint. Errors: access_denied, readers_differ.
  [[nodiscard]] Result<void> check_endpoint(const PeerIdentity& who, ClientIndex client,
                                            const CreateRequest& request) const;
  /// Logs a warning if users have the process's memory who may not subscribe now, or the reverse.
  void warn_of_other_readers(ClientIndex client);
  /// Returns a sentence about an endpoint that the current rules forbid; empty: none.
  std::string forbidden_endpoint(ClientIndex client, const PeerIdentity& identity) const;

 private:
  [[nodiscard]] Result<void> check_readers(ClientIndex client, std::uint64_t domain,
                                           std::string_view topic) const;
  [[nodiscard]] Result<void> check_publishers(const Subject& who, std::uint64_t domain,
                                              std::string_view topic) const;

  const std::vector<AccessRule>& rules_;
  const Registry& registry_;
  Log& log_;
};

}  // namespace agnocast::daemon
