// SPDX-License-Identifier: Apache-2.0
//
// FairScheduler: serves users in turn. Pure; the caller passes the time.
//
// Each user with waiting connections gets a time slice of so many packets and so many
// milliseconds, however many connections they come from. At least one packet of each user is
// handled. Connections that do not fit into a slice wait in order of arrival until every other
// user has had a slice.
#pragma once

#include <daemon/transport/connection_table.hpp>

#include <algorithm>
#include <cstdint>
#include <deque>
#include <iterator>
#include <optional>
#include <unordered_map>

namespace agnocast::daemon {

/// What is left of one user's time slice.
struct TimeSlice {
  // Other users must not wait for a flood of packets, nor for expensive ones.
  static constexpr unsigned packets_max = 32;
  static constexpr std::uint64_t budget_ns = 2'000'000;

  unsigned packets_left = packets_max;
  std::uint64_t until_ns = UINT64_MAX;
};

class FairScheduler {
 public:
  /// Appends a connection that is not waiting yet to the queue of its user.
  void wait(std::uint32_t uid, PeerId id) { waiting_[uid].push_back(id); }
  bool nobody_waits() const noexcept { return waiting_.empty(); }

  /// Gives every waiting user one slice. `serve(id, slice)` returns how many packets it handled,
  /// or nothing when the connection is gone, which costs nothing. `now_ns()` returns
  /// CLOCK_MONOTONIC.
  template <class Serve, class Now>
  void serve(Serve serve, Now now_ns) {
    for (auto user = waiting_.begin(); user != waiting_.end();) {
      std::deque<PeerId>& queue = user->second;
      TimeSlice slice{TimeSlice::packets_max, now_ns() + TimeSlice::budget_ns};
      while (slice.packets_left > 0 && !queue.empty()) {
        const PeerId id = queue.front();
        queue.pop_front();
        const std::optional<unsigned> count = serve(id, slice);
        if (!count) continue;
        const bool late = now_ns() >= slice.until_ns;
        slice.packets_left =
            late ? 0 : slice.packets_left - std::clamp(*count, 1U, slice.packets_left);
      }
      user = queue.empty() ? waiting_.erase(user) : std::next(user);
    }
  }

 private:
  std::unordered_map<std::uint32_t, std::deque<PeerId>> waiting_;  // by uid
};

}  // namespace agnocast::daemon
