// SPDX-License-Identifier: Apache-2.0

#include <client/shares/user_bans.hpp>

#include <algorithm>

namespace agnocast {

void UserBans::add(PeerOwner owner, Clock::time_point now) {
  if (owner.is_own) return;
  std::erase_if(bans_, [&](const auto& ban) { return now >= ban.second.end + longest; });
  const auto [at, is_new] = bans_.try_emplace(owner.uid, Ban{now, first});
  Ban& ban = at->second;
  if (!is_new) ban.length = std::min(2 * ban.length, longest);
  ban.end = now + ban.length;
}

bool UserBans::has(PeerOwner owner, Clock::time_point now) const {
  if (owner.is_own) return false;
  const auto found = bans_.find(owner.uid);
  return found != bans_.end() && now < found->second.end;
}

}  // namespace agnocast
