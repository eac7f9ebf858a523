// SPDX-License-Identifier: Apache-2.0
//
// SessionState: how far one session of this process has come, and what its users are told. Pure.
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
//   whatever is present    unconnected, moving, arrived, serving ──lose──▶ alone
//
//   step         caller                               meaning
//   connected    Context::connect                     it has said hello, and its control thread
//   runs be_present   Reregistration::begin_next           new endpoints are made in it from now on
//   drop         Context::Drop                        it could not begin; its control thread ends
//   it arrived      Reregistration::move_everything      whatever moves from the former session was
//   asked for once speak        the control thread, while connected  it tells its users of its
//   connection from now on lose         the control thread                   its daemon's store is
//   lost, and nobody will know this session again
//
// A step that a phase does not know changes nothing. `alone` and `dropped` are left by none.
//
//                  unconnected  beginning  lost  dropped  moving  arrived  serving  alone
//   is_connected        ·           x        x      ·        x       x        x       x
//   is_beginning        ·           x        x      ·        ·       ·        ·       ·
//   is_alone            ·           ·        x      ·        ·       ·        ·       x
//   speaks              x           ·        ·      ·        ·       ·        x       x
//
// Of a session that is beginning its starter decides how it ends, also when it is lost meanwhile.
// Its users still know it as an orphaned session, as the former session told them, so it does not
// speak before its endpoints are there. One that is alone was an orphaned session before, whether
// it spoke or not, so there is nothing more to say of its connection.
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

  /// Of a further session, before anybody else knows it: it is an orphaned session for the reason
  /// that the former one has.
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

  // --- truths

  /// The process has a place with the daemon, or had one.
  bool is_connected() const noexcept {
    const Phase now = phase();
    return now != Phase::unconnected && now != Phase::dropped;
  }
  /// It is not present yet, and its starter ends it.
  bool is_beginning() const noexcept {
    const Phase now = phase();
    return now == Phase::beginning || now == Phase::lost;
  }
  bool is_dropped() const noexcept { return phase() == Phase::dropped; }
  /// An orphaned session whose daemon will not come back.
  bool is_alone() const noexcept {
    const Phase now = phase();
    return now == Phase::alone || now == Phase::lost;
  }
  /// It was present, and is alone: it ends by itself as soon as another session is present and
  /// nobody uses it.
  bool may_end_by_itself() const noexcept { return phase() == Phase::alone; }
  /// What becomes of its connection is told to its users.
  bool speaks() const noexcept {
    const Phase now = phase();
    return now == Phase::unconnected || now == Phase::serving || now == Phase::alone;
  }

  // --- what users are told

  ConnectionState connection() const noexcept {
    return connection_.load(std::memory_order_acquire);
  }
  /// Why it is an orphaned session.
  Errc reason() const noexcept { return reason_.load(std::memory_order_acquire); }
  /// Returns whether that is news that users are to hear.
  bool tell(ConnectionState connection) noexcept {
    return speaks() && connection_.exchange(connection, std::memory_order_acq_rel) != connection;
  }
  /// Returns whether it is another reason than before.
  bool give_reason(Errc reason) noexcept {
    return reason_.exchange(reason, std::memory_order_acq_rel) != reason;
  }
  /// What there was before. Nobody is told.
  ConnectionState set(ConnectionState connection) noexcept {
    return connection_.exchange(connection, std::memory_order_acq_rel);
  }

 private:
  std::atomic<Phase> phase_{Phase::unconnected};
  std::atomic<ConnectionState> connection_{ConnectionState::unconnected};
  std::atomic<Errc> reason_{Errc::ok};
};

}  // namespace agnocast
