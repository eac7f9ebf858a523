// SPDX-License-Identifier: Apache-2.0

#include <client/shares/unmapped_users.hpp>

namespace agnocast {

void UnmappedUsers::note(PeerOwner owner) {
  if (!owner.is_own) noted_.insert(owner.uid);
}

void UnmappedUsers::look(Clock::time_point now) {
  times_.look(now, noted_);
  for (const std::uint32_t uid : noted_) {
    if (times_.is_over(uid)) ban({uid, false}, now);
  }
  noted_.clear();
}

void UnmappedUsers::ban(PeerOwner owner, Clock::time_point now) {
  bans_.add(owner, now);
  if (!owner.is_own) times_.forget(owner.uid);
}

}  // namespace agnocast
