// SPDX-License-Identifier: Apache-2.0
//
// Departures: endpoints of one session that leave, their reports to the daemon, and the threads
// that wait for the daemon's answer.
//
//   wanted ──say(), in the control thread──▶ reported ──answer──▶ known ──▶ waiters go on
//
// An unclaimed endpoint of this process is known to the daemon only: its caller gave up during the
// creation, or the endpoint ended here while the daemon was away. No code of this process has it,
// so it holds and publishes nothing. It is drained as soon as the daemon has let it leave.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <client/connection/connection.hpp>
#include <client/endpoint/departure.hpp>
#include <client/endpoint/endpoint_table.hpp>
#include <client/heap/sparse_region.hpp>
#include <client/process/control_wake.hpp>

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

  /// Waits until the daemon knows of the departure: not at all while the daemon is away, at most
  /// `answer_timeout` of the connection, and not beyond `end`. The caller wakes the control thread.
  void wait_for(const Departure& departure, const Connection& connection,
                Clock::time_point end) noexcept;
  /// Wakes the waiting threads: a departure is known, or the daemon is away.
  void notify() noexcept;

  // --- control thread

  /// Reports the departures that are due. `wake`: that of the control thread.
  void say(Connection& connection, const std::shared_ptr<const ControlWake>& wake);
  /// Takes an endpoint that the daemon knows and this process does not.
  void adopt_unclaimed(Kind kind, const Key& key, std::uint64_t generation, bool has_left);
  /// Drains unclaimed endpoints, while the connection is open. `board`: says which publishers every
  /// other process has released.
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
