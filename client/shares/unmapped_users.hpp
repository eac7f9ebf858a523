// SPDX-License-Identifier: Apache-2.0
//
// UnmappedUsers: users whose subscriptions this process could not map for too long. Pure.
//
// Everything counts as held by a subscription that is announced and cannot be mapped. So it has some seconds, and these
// belong to its user (UserPatience): subscriptions that follow each other, each of which leaves in time, use up the same
// ones. Nor does a subscription that can be mapped give them back: an attacker would have one of these at hand.
// A process's own user always has patience.
#pragma once

#include <client/shares/peer_owner.hpp>
#include <client/shares/reader_shares.hpp>
#include <client/shares/user_bans.hpp>
#include <client/shares/user_patience.hpp>

namespace agnocast {

class UnmappedUsers {
 public:
  using Clock = UserBans::Clock;

  /// A subscription of this user was not mapped at some time since the last look. Allocates.
  void note(PeerOwner owner);
  /// Once a second or so: bans the users that were noted too often. Allocates.
  void look(Clock::time_point now);
  /// One of the user's subscriptions alone was not mapped for too long. Allocates.
  void ban(PeerOwner owner, Clock::time_point now);
  /// Returns whether this process waits for no subscription of the user that it cannot map.
  bool is_out(PeerOwner owner, Clock::time_point now) const { return bans_.has(owner, now); }

 private:
  UserPatience::Uids noted_;
  UserPatience times_{ReaderShares::patience_to_attach};
  UserBans bans_;
};

}  // namespace agnocast
