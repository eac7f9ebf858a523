// SPDX-License-Identifier: Apache-2.0
//
// SessionState: the phase of one session of this process, and what its users are notified of. Pure.
//
//   the first session      unconnected ──connected──▶ serving
//
//   a further one          beginning ──be_present──▶ moving ──arrived──▶ arrived ──speak──▶ serving
//                           │     └────drop─────▶ dropped
//                           │                        ▲
//                          lose                      │
//                           ▼                        │
//                          lost ────────drop─────────┘
//                           └──be_present──▶ alone
//
//   the current session    unconnected, moving, arrived, serving ──lose──▶ alone
//
//   step         caller                               meaning
//   connected    Context::connect                     hello is answered, the control thread runs
//   be_present   Reregistration::begin_next           new endpoints are made in it from now on
//   drop         Context::Drop                        it could not begin: its thread ends it
//   arrived      Reregistration::move_everything      all that moves was asked for once
//   speak        the control thread, while connected  from now on it notifies its users
//   lose         the control thread                   its daemon's store is lost, for good
//
// A step that a phase does not list changes nothing. `alone` and `dropped` are final.
//
//                  unconnected  beginning  lost  dropped  moving  arrived  serving  alone
//   is_connected        ·           x        x      ·        x       x        x       x
//   is_beginning        ·           x        x      ·        ·       ·        ·       ·
//   is_alone            ·           ·        x      ·        ·       ·        ·       x
//   speaks              x           ·        ·      ·        ·       ·        x       x
//
// The thread that begins a session decides how the beginning ends, also if the session is lost
// meanwhile. Users still know it as orphaned, from the previous session, so it does not notify them
// before its endpoints are there. A session that is alone was orphaned before, whether it spoke or
// not, so there is nothing more to report of its connection.
#pragma once

#include <agnocast/connection_state.hpp>
#include <agnocast/error.hpp>

#include <atomic>
#include <cstdint>

namespace agnocast {

/// Any thread.
class SessionState {
 public:
  enum class Phase : std::uint8_t {
    unconnected,
    beginning,
    lost,
    dropped,
    moving,
    arrived,
    serving,
    alone,
  };
  enum class Step : std::uint8_t { connected, be_present, drop, arrived, speak, lose };

  static constexpr Phase after(Phase phase, Step step) noexcept {
    switch (step) {
      case Step::connected:
        return phase == Phase::unconnected ? Phase::serving : phase;
      case Step::be_present:
        if (phase == Phase::lost) return Phase::alone;
        return phase == Phase::beginning ? Phase::moving : phase;
      case Step::drop:
        return phase == Phase::beginning || phase == Phase::lost ? Phase::dropped : phase;
      case Step::arrived:
        return phase == Phase::moving ? Phase::arrived : phase;
      case Step::speak:
        return phase == Phase::arrived ? Phase::serving : phase;
      case Step::lose:
        if (phase == Phase::beginning) return Phase::lost;
        return phase == Phase::lost || phase == Phase::dropped ? phase : Phase::alone;
    }
    return phase;
  }

  /// Begins a further session, before any other thread knows it: it is orphaned for the same reason
  /// as the previous one.
  void begin_beside(const SessionState& former) noexcept {
    phase_.store(Phase::beginning, std::memory_order_relaxed);
    connection_.store(ConnectionState::orphaned, std::memory_order_relaxed);
    reason_.store(former.reason(), std::memory_order_relaxed);
  }
  /// Returns whether the phase has changed.
  bool step(Step step) noexcept {
    Phase before = phase_.load(std::memory_order_acquire);
    while (!phase_.compare_exchange_weak(before, after(before, step), std::memory_order_acq_rel,
                                         std::memory_order_acquire)) {
    }
    return before != after(before, step);
  }
  Phase phase() const noexcept { return phase_.load(std::memory_order_acquire); }

  // --- properties of the phases

  /// Returns whether the process has a place with the daemon, or had one.
  bool is_connected() const noexcept {
    const Phase now = phase();
    return now != Phase::unconnected && now != Phase::dropped;
  }
  /// Returns whether it is not current yet; the thread that began it ends it.
  bool is_beginning() const noexcept {
    const Phase now = phase();
    return now == Phase::beginning || now == Phase::lost;
  }
  bool is_dropped() const noexcept { return phase() == Phase::dropped; }
  /// Returns whether it is an orphaned session whose daemon will not come back.
  bool is_alone() const noexcept {
    const Phase now = phase();
    return now == Phase::alone || now == Phase::lost;
  }
  /// Returns whether it was current and is alone: it ends by itself as soon as another session is
  /// current and nothing uses it.
  bool may_end_by_itself() const noexcept { return phase() == Phase::alone; }
  /// Returns whether users are notified of its connection.
  bool speaks() const noexcept {
    const Phase now = phase();
    return now == Phase::unconnected || now == Phase::serving || now == Phase::alone;
  }

  // --- what users are notified of

  ConnectionState connection() const noexcept {
    return connection_.load(std::memory_order_acquire);
  }
  /// Returns why it is an orphaned session.
  Errc reason() const noexcept { return reason_.load(std::memory_order_acquire); }
  /// Returns whether users have to be notified of this.
  bool tell(ConnectionState connection) noexcept {
    return speaks() && connection_.exchange(connection, std::memory_order_acq_rel) != connection;
  }
  /// Returns whether the reason has changed.
  bool give_reason(Errc reason) noexcept {
    return reason_.exchange(reason, std::memory_order_acq_rel) != reason;
  }
  /// Sets the state without notifying users. Returns the state before.
  ConnectionState set(ConnectionState connection) noexcept {
    return connection_.exchange(connection, std::memory_order_acq_rel);
  }

 private:
  std::atomic<Phase> phase_{Phase::unconnected};
  std::atomic<ConnectionState> connection_{ConnectionState::unconnected};
  std::atomic<Errc> reason_{Errc::ok};
};

}  // namespace agnocast
