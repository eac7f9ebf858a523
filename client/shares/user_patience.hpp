// SPDX-License-Identifier: Apache-2.0
//
// UserPatience: records how long users have cost this process too much, and whether that was too
// long. Pure.
//
// The control thread checks at intervals. A check that finds a user costly adds its interval to
// that user's time, and each other check subtracts a twelfth of its interval. So a user that
// stops for a moment does not begin anew: one that costs too much for more than a thirteenth of
// the time runs out of patience. A user without time is forgotten, a little more than a minute
// after five seconds were used up.
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <set>

namespace agnocast {

class UserPatience {
 public:
  using Clock = std::chrono::steady_clock;
  using Uids = std::set<std::uint32_t>;
  /// A process that did not run for a while does not know what its users did meanwhile.
  static constexpr std::chrono::seconds longest_look{1};

  explicit UserPatience(Clock::duration patience) : patience_(patience) {}
  /// Call it about once a second, with all users that cost too much now. Allocates.
  void look(Clock::time_point now, const Uids& costly);
  /// Returns whether the user's own time is longer than the patience.
  bool is_over(std::uint32_t uid) const;
  void forget(std::uint32_t uid) { times_.erase(uid); }
  void forget_all() { times_.clear(); }

 private:
  static constexpr int leak_divisor = 12;

  Clock::duration patience_;
  Clock::time_point looked_{};
  std::map<std::uint32_t, Clock::duration> times_;  // by uid
};

}  // namespace agnocast
