// SPDX-License-Identifier: Apache-2.0
//
// ControlThread: the one library thread of a session. In each cycle it reads the daemon's packets
// in order and then runs the periodic work: it removes what has ended, reports that to the daemon,
// and does everything that user threads leave to it. When the connection was lost it reconnects
// (rejoining.cpp).
//
//   serve ──▶ serve_once ──▶ read_connection ──▶ handle: Announcements, or a handler of the session
//                       └──▶ run_upkeep: Departures, ReaderLook, Collector, OwnHeap
//
// It ends with the process, with a dropped session, and with a previous session that is unused.
#pragma once

#include <agnocast/connection_state.hpp>
#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <client/connection/reannouncement.hpp>
#include <client/connection/reconnection.hpp>
#include <client/connection/registration.hpp>
#include <client/endpoint/endpoint_table.hpp>
#include <client/endpoint/peer_table.hpp>
#include <client/session/session_state.hpp>
#include <client/session/wait_set_places.hpp>
#include <client/upkeep/announcements.hpp>
#include <client/upkeep/collector.hpp>
#include <client/upkeep/departures.hpp>
#include <client/upkeep/own_heap.hpp>
#include <client/upkeep/reader_look.hpp>
#include <client/upkeep/scan_timer.hpp>
#include <client/upkeep/thread_report.hpp>

#include <chrono>

namespace agnocast {

class Context;

class ControlThread {
 public:
  /// The session that it serves.
  struct Parts {
    Context* context;
    SessionState& state;
    Registration& registration;
    WaitSetPlaces& places;
    EndpointTable& endpoints;
    PeerTable& peers;
    OwnHeap& heap;
    Departures& departures;
  };
  explicit ControlThread(const Parts& parts) noexcept
      : context_(parts.context),
        state_(parts.state),
        registration_(parts.registration),
        places_(parts.places),
        endpoints_(parts.endpoints),
        peers_(parts.peers),
        heap_(parts.heap),
        departures_(parts.departures) {}

  /// Prepares the thread, once the registration is there. Errors: os_failure.
  [[nodiscard]] Result<void> prepare();
  /// Runs the thread.
  void serve() noexcept;

  // --- any thread, for a session that is alone

  /// Notifies users that the session is orphaned for this reason.
  void tell_reason(Errc reason) noexcept;
  /// Does the same, and ends all further attempts.
  void stay_orphaned(const Failure& why) noexcept;

 private:
  struct Handler;

  void serve_nobody() noexcept;
  void serve_once(int timeout_ms);
  void look_for_descriptors(bool now) noexcept;
  int scan_due_ms();
  void read_connection();
  void look_for_doorbells() noexcept;
  void run_upkeep();
  Result<void> watch(int fd) noexcept;

  void handle(Incoming& packet);
  void on_doorbells_renewed(Incoming& packet);
  void on_rejoined(Incoming& packet);
  void on_refused(Incoming& packet);
  void on_revoked(Incoming& packet);
  void on_own(Incoming& packet);
  void on_region(Incoming& packet);

  // coming back
  void reconnect();
  Result<void> introduce_again();
  void lose_connection() noexcept;
  void become_orphaned(const Failure& why) noexcept;
  void tell_state(ConnectionState state) noexcept;

  // a previous session
  bool is_former() const noexcept;
  void run_former_upkeep();
  bool unmap_everything();

  Context* const context_;
  SessionState& state_;
  Registration& registration_;
  WaitSetPlaces& places_;
  EndpointTable& endpoints_;
  PeerTable& peers_;
  OwnHeap& heap_;
  Departures& departures_;

  ReaderLook readers_;
  ThreadReport threads_;
  Announcements announcements_{endpoints_, peers_, readers_, heap_.growth()};
  Collector collector_{endpoints_, peers_};
  UniqueFd epoll_;
  Reconnection reconnection_;
  Reannouncement reannouncement_;
  ScanTimer scan_timer_;
  bool is_output_blocked_ = false, descriptors_lost_ = false;
  std::chrono::steady_clock::time_point former_looked_{}, descriptors_looked_{};
};

}  // namespace agnocast
