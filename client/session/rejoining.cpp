// SPDX-License-Identifier: Apache-2.0
//
// Coming back: what the control thread does after a connection has ended. docs/control-plane.md.
//
// Nothing in shared memory depends on the connection: messages flow on and scans run as always. The
// control thread tries to connect, ever more rarely, and sends its identity (rejoin). If the daemon
// knows it, waiting requests are sent again, and the daemon sends what it knows: every endpoint of
// the process (own), every announcement that it made, and the regions (region). The client
// recognises what it has; for what it no longer has it reports again: left, drained, unlinked. So
// neither side depends on the arrival of an earlier packet.
//
// If the daemon refuses, the session is orphaned. If the daemon has lost its store, the process
// begins another session (reregistration.hpp), and this one ends when it is unused.

#include <client/process/forked_child.hpp>
#include <client/session/context.hpp>
#include <client/session/control_thread.hpp>
#include <client/session/host_graph.hpp>
#include <client/session/reregistration.hpp>

#include <base/descriptors/kept_fd.hpp>
#include <client/process/steps.hpp>

#include <sys/epoll.h>

#include <utility>

namespace agnocast {

namespace wire = abi::wire;
using wire::Kind;

void ControlThread::tell_state(ConnectionState state) noexcept {
  if (state_.tell(state)) endpoints_.tell({state, state_.reason()});
  departures_.notify();  // no thread waits for a daemon that is away
}

void ControlThread::lose_connection() noexcept {
  if (reconnection_.state() == Reconnection::State::orphaned) return;
  if (registration_.connection().fd() >= 0 && !has_lost_kept())
    ::epoll_ctl(epoll_.get(), EPOLL_CTL_DEL, registration_.connection().fd(), nullptr);
  registration_.connection().end();
  threads_.forget();
  if (&Context::instance() == context_) HostGraph::instance().connection_ended();
  reconnection_.ended(Reconnection::Clock::now());
  tell_state(reconnection_.is_refused() ? ConnectionState::orphaned
                                        : ConnectionState::reconnecting);
}

void ControlThread::become_orphaned(const Failure& why) noexcept {
  if (reconnection_.state() == Reconnection::State::orphaned) return;
  lose_connection();
  if (is_mended_by_people(why.code)) {
    reconnection_.refused_until_mended(Reconnection::Clock::now());
  } else {
    reconnection_.refused();
  }
  state_.give_reason(why.code);
  registration_.connection().refuse(why);
  if (why.code == Errc::revoked) {
    AGNOCAST_CRASH_POINT(C_revoked);
    end_service();
    AGNOCAST_CRASH_POINT(C_revoked);
    endpoints_.revoke();
  }
  tell_state(ConnectionState::orphaned);
  if (why.code != Errc::started_anew) return;
  state_.step(SessionState::Step::lose);
  AGNOCAST_CRASH_POINT(C_store_lost);
  endpoints_.be_alone();
  Reregistration::instance().begin();
}

void ControlThread::tell_reason(Errc reason) noexcept {
  if (state_.give_reason(reason)) endpoints_.tell({ConnectionState::orphaned, reason});
}

void ControlThread::stay_orphaned(const Failure& why) noexcept {
  registration_.connection().refuse(why);
  tell_reason(why.code);
}

void ControlThread::reconnect() {
  const Result<void> asked = introduce_again();
  if (asked) return;
  if (asked.error().code == Errc::daemon_untrusted) return become_orphaned(asked.error());
  lose_connection();
}

Result<void> ControlThread::introduce_again() {
  if (Result<void> connected = registration_.connect_again(); !connected) return connected;
  reconnection_.asked();
  if (Result<void> watched = watch(registration_.connection().fd()); !watched) return watched;
  return registration_.say_rejoin();
}

void ControlThread::on_rejoined(Incoming& packet) {
  wire::Rejoined body{};
  if (reconnection_.state() != Reconnection::State::rejoining || !packet.read(body) ||
      body.incarnation != registration_.incarnation())
    return lose_connection();
  registration_.say_blocked();  // it may be another daemon process
  AGNOCAST_CRASH_POINT(C_rejoined);
  registration_.connection().open();
  reconnection_.succeeded(Reconnection::Clock::now());
  if (state_.speaks()) state_.give_reason(Errc::ok);
  tell_state(ConnectionState::connected);
}

void ControlThread::on_refused(Incoming& packet) {
  if (reconnection_.state() != Reconnection::State::rejoining) return;
  const Failure why = refusal_of(packet);
  switch (why.code) {
    case Errc::started_anew:
    case Errc::revoked:
    case Errc::layout_mismatch:
    case Errc::store_damaged:
    case Errc::permission_denied:
      return become_orphaned(why);
    default:  // it has no room, or no descriptor, for one more connection now
      return lose_connection();
  }
}

void ControlThread::on_revoked(Incoming& packet) {
  become_orphaned(failure_with(Errc::revoked, detail_of(refusal_of(packet))));
}

// --- what the daemon has of this process

void ControlThread::on_own(Incoming& packet) {
  wire::Own own{};
  if (!packet.read(own)) return;
  if (registration_.connection().is_waiting(own.creation)) return;  // its answer will come
  const EndpointTable::Key key{own.topic, own.index};
  Departure* const departure = endpoints_.departure_of(own.kind, key, own.generation);
  if (departure == nullptr) {
    departures_.adopt_unclaimed(own.kind, key, own.generation, own.active == 0);
  } else if (own.active == 0 && departure->is_wanted()) {
    departure->known();
  } else if (own.active != 0 && departure->is_known()) {
    departure->forgotten();  // an orphaned session takes every refusal for the daemon's answer to
                             // leave
  }
}

void ControlThread::on_region(Incoming& packet) {
  wire::Reference region{};
  if (reannouncement_.is_awaited()) return;  // it may be one whose descriptors were lost
  if (packet.read(region) && !peers_.has({region.index, region.generation}))
    say_unlinked(registration_.connection(), Kind::region, 0, region.index, region.generation);
}

}  // namespace agnocast
