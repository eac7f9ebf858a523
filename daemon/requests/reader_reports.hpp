// SPDX-License-Identifier: Apache-2.0
//
// ReaderReports: reports of readers that get less than others: those that a publisher no longer
// serves, reported by its process, and those that cannot be rung, found by the daemon. Each change
// is a record of the redo log and a line of the log, for people who ask later; nothing else
// follows.
#pragma once

#include <base/sockets/peer_identity.hpp>
#include <base/text/log.hpp>
#include <daemon/requests/reader_notes.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/doorbells.hpp>
#include <daemon/transport/request_reading.hpp>

#include <cstdint>

namespace agnocast::daemon {

class ReaderReports {
 public:
  ReaderReports(Registry& registry, Doorbells& doorbells, Log& log) noexcept
      : registry_(registry), doorbells_(doorbells), log_(log) {}

  /// Handles a client's report about a publisher of its own.
  void withdrawn(const PeerIdentity& identity, ClientIndex client, const wire::Withdrawn& report);
  /// Checks whether the wait set of a new subscription can be rung.
  void created(ClientIndex client, const CreateRequest& request);
  /// Tries some of the doorbells, see Doorbells::look().
  void look_for_silent_doorbells(std::uint64_t now_ms);

 private:
  void mute(const EndpointRef& subscription);

  Registry& registry_;
  Doorbells& doorbells_;
  Log& log_;
  ReaderNotes notes_;
};

}  // namespace agnocast::daemon
