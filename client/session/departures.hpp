// SPDX-License-Identifier: Apache-2.0
//
// Departures: endpoints of one session that leave: what the daemon is told of them, and who waits
// until it knows.
//
//   wanted (any thread) ──say(), in the control thread──▶ said ──answer──▶ known ──▶ whoever waits goes on
//
// Unclaimed are endpoints of this process that only the daemon knows about: nobody waits for their
// creation any more, or they were over here while the daemon was away. Nobody else was ever given
// such an endpoint, so nothing of it is held or published: it is drained as soon as the daemon has
// let it leave.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <client/endpoint/departure.hpp>
#include <client/endpoint/endpoint_table.hpp>
#include <client/heap/sparse_region.hpp>
#include <client/process/control_wake.hpp>
#include <client/session/connection.hpp>

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <utility>

namespace agnocast {

class Departures {
 public:
  using Clock = std::chrono::steady_clock;
  using Kind = abi::wire::Kind;
  using Key = EndpointTable::Key;

  explicit Departures(EndpointTable& endpoints) noexcept : endpoints_(endpoints) {}

  // --- any thread

  /// Until the daemon knows of it; while it is away not at all, `answer_timeout` of the connection
  /// at most, and not beyond `end`. The control thread was woken.
  void wait_for(const Departure& departure, const Connection& connection,
                Clock::time_point end) noexcept;
  /// Who waits looks again: something is known, or the daemon is away.
  void notify() noexcept;

  // --- control thread

  /// Says what is wanted and was not said. `wake`: of the control thread.
  void say(Connection& connection, const std::shared_ptr<const ControlWake>& wake);
  /// The daemon knows of an endpoint that is not here.
  void adopt_unclaimed(Kind kind, const Key& key, std::uint64_t generation, bool has_left);
  /// While the connection is open. `board`: says whom everybody else has let go of.
  void end_unclaimed(Connection& connection, const std::shared_ptr<const ControlWake>& wake,
                     SparseRegion& board);
  void forget_unclaimed() noexcept { unclaimed_.clear(); }

 private:
  struct UnclaimedEndpoint {
    explicit UnclaimedEndpoint(std::uint64_t known_generation) noexcept
        : generation(known_generation) {}
    std::uint64_t generation;
    Departure departure;
  };

  void say_one(Connection& connection, const std::shared_ptr<const ControlWake>& wake,
               Departure& departure, const abi::wire::Reference& who, std::shared_ptr<void> keeps);

  EndpointTable& endpoints_;
  std::mutex mutex_;
  std::condition_variable known_;
  std::map<std::pair<Kind, Key>, std::shared_ptr<UnclaimedEndpoint>> unclaimed_;
};

}  // namespace agnocast
