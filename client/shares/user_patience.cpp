// SPDX-License-Identifier: Apache-2.0

#include <client/shares/user_patience.hpp>

#include <algorithm>
#include <iterator>
#include <utility>

namespace agnocast {

void UserPatience::look(Clock::time_point now, const Uids& costly) {
  const Clock::duration interval = now - std::exchange(looked_, now);
  const Clock::duration gain = std::min<Clock::duration>(interval, longest_look);
  const Clock::duration leak = interval / leak_divisor;
  for (auto user = times_.begin(); user != times_.end();) {
    if (costly.count(user->first) == 0) user->second -= leak;
    user = user->second <= Clock::duration::zero() ? times_.erase(user) : std::next(user);
  }
  // Longer times have no further effect, and would take longer to leak away.
  const Clock::duration longest = patience_ + longest_look;
  for (const std::uint32_t uid : costly) {
    Clock::duration& time = times_[uid];
    time = std::min(time + gain, longest);
  }
}

bool UserPatience::is_over(std::uint32_t uid) const {
  const auto found = times_.find(uid);
  return found != times_.end() && found->second > patience_;
}

}  // namespace agnocast
