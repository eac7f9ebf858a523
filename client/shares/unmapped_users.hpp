// SPDX-License-Identifier: Apache-2.0
//
// UnmappedUsers: users whose subscriptions this process could not map for too long. Pure.
//
// A subscription that is announced but cannot be mapped counts as holding everything. So it has
// some seconds, which belong to its user (UserPatience): consecutive subscriptions, each of which
// leaves in time, use up the same time. A subscription that can be mapped does not give it back:
// an attacker would keep one of these. A process's own user always has patience.
#pragma once

#include <client/shares/peer_owner.hpp>
#include <client/shares/reader_shares.hpp>
#include <client/shares/user_bans.hpp>
#include <client/shares/user_patience.hpp>

namespace agnocast {

class UnmappedUsers {
 public:
  using Clock = UserBans::Clock;

  /// Notes that a subscription of this user was unmapped at some time since the last look().
  /// Allocates.
  void note(PeerOwner owner);
  /// Call it about once a second: bans the users that were noted too often. Allocates.
  void look(Clock::time_point now);
  /// Bans a user because one of its subscriptions alone was unmapped for too long. Allocates.
  void ban(PeerOwner owner, Clock::time_point now);
  /// Returns whether this process waits for none of the user's subscriptions that it cannot map.
  bool is_out(PeerOwner owner, Clock::time_point now) const { return bans_.has(owner, now); }

 private:
  UserPatience::Uids noted_;
  UserPatience times_{ReaderShares::patience_to_attach};
  UserBans bans_;
};

}  // namespace agnocast
