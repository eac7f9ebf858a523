// SPDX-License-Identifier: Apache-2.0
//
// UserBans: users whose subscriptions this process refuses for a while, because those cost it
// more than their share. Pure.
//
// The first ban of a user lasts a minute, each further one twice as long as the one before, up to
// an hour. The daemon's users are many and cheap (subordinate uids): if each ban were as short as
// the first, a dozen of them could alternate, and one of them would always be back. A user is
// forgotten an hour after its last ban. The process's own user is never banned.
#pragma once

#include <client/shares/peer_owner.hpp>

#include <chrono>
#include <cstdint>
#include <map>

namespace agnocast {

class UserBans {
 public:
  using Clock = std::chrono::steady_clock;
  static constexpr std::chrono::seconds first{60}, longest{3600};

  /// Bans `owner` from now on, longer than the last time. Allocates.
  void add(PeerOwner owner, Clock::time_point now);
  bool has(PeerOwner owner, Clock::time_point now) const;

 private:
  struct Ban {
    Clock::time_point end;
    std::chrono::seconds length;
  };
  std::map<std::uint32_t, Ban> bans_;  // by uid
};

}  // namespace agnocast
