// SPDX-License-Identifier: Apache-2.0
//
// RequestScheduler: decides when a connection is read.
//
//   event ──▶ waits for its user's time slice ──▶ read ──▶ parked, if a request waits for an errand
//                                                            └── errand done: unpark, the request goes on
//
// Users are served in turn: a user with a thousand connections gets as much time as a user with
// one. Nothing is read from a parked connection. A ticket numbers the errand that it waits for, so
// a late errand finds no connection once that waits for another one.
#pragma once

#include <daemon/death/client_termination.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/dispatcher.hpp>
#include <daemon/transport/fair_scheduler.hpp>

#include <cstdint>
#include <functional>
#include <optional>

namespace agnocast::daemon {

class RequestScheduler {
 public:
  RequestScheduler(ConnectionTable& connections, Dispatcher& dispatcher,
                   ClientTermination& termination) noexcept
      : connections_(connections), dispatcher_(dispatcher), termination_(termination) {}

  /// Returns the dispatcher's handler for events of a connection or, `ended`, of its process.
  Dispatcher::Handler event_handler(PeerId id, bool ended);
  bool nobody_waits() const noexcept { return users_.nobody_waits(); }
  using Serve = std::function<std::optional<unsigned>(PeerId, const TimeSlice&)>;
  /// Gives every waiting user a time slice, see FairScheduler::serve().
  void serve(const Serve& serve);

  std::uint64_t next_ticket() noexcept { return ++last_ticket_; }
  /// Reads nothing from it until unpark().
  void park(Peer& peer, std::uint64_t ticket);
  /// Returns the connection parked with this ticket; null: none, or it is not to be served.
  Peer* unpark(PeerId id, std::uint64_t ticket);

 private:
  void wait_for_slice(PeerId id, bool ended);

  ConnectionTable& connections_;
  Dispatcher& dispatcher_;
  ClientTermination& termination_;
  FairScheduler users_;
  std::uint64_t last_ticket_ = 0;
};

}  // namespace agnocast::daemon
