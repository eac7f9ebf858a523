// SPDX-License-Identifier: Apache-2.0
//
// ReaderShares: decides how much of this process's heap readers of other users may keep. Pure.
//
// The number of messages that foreign subscriptions may hold is fixed when they subscribe; the
// sizes are unknown then. So the control thread checks once a second, for two cases:
//   - the heap, which could not grow any more, has refused an allocation within the last minute:
//     readers of all other users may keep half of the bytes that the heap has ever taken of its
//     windows, which is all that a full heap has;
//   - it has not, but readers of other users keep half of what it may become. That counts as no
//     more than a quarter of the machine's memory (client/shares/machine_memory.hpp): a heap may
//     usually become larger than that, and the system would kill a process before the heap refuses
//     anything. So eight publishers whose readers all keep their maximum fill the memory, each of
//     them an eighth.
// One user has at most half of that half; if the half does not suffice, each user has an equal
// part, and the others share what users below their part leave. Each user above its share has a
// few seconds of its own, in checks that need not follow each other (UserPatience). If a user is
// above after that, and the heap has refused another allocation or is still beyond its limit,
// this process stops serving, all in one check, those of such users' readers that keep most
// (PublisherCore::withdraw), and for a while newcomers of these users (UserBans), which would
// begin anew. A user that is above for the first time keeps its seconds, however long others
// were. A publisher that is refused less than once a minute begins anew each time: the state of
// its heap in between is unknown. A process's own user has no limit.
//
//   a user is above → its patience → is above again → withdrawn → patience → disregarded
#pragma once

#include <client/shares/user_bans.hpp>
#include <client/shares/user_patience.hpp>

#include <chrono>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace agnocast {

class ReaderShares {
 public:
  using Clock = std::chrono::steady_clock;
  /// An honest reader needs this time to release the messages in use and the superfluous ones;
  /// each step of the way allows it again.
  static constexpr std::chrono::seconds patience{5};
  /// A heap counts as full for this time after the last refusal.
  static constexpr std::chrono::seconds full_for{60};
  /// Subscriptions announced late by the daemon are served again; that is rare, and loses
  /// messages.
  static constexpr std::chrono::seconds patience_to_attach{10};

  struct Room {
    std::uint64_t refused;     // allocations that found no room, since the start
    bool may_grow;             // one more window was not refused, or not requested yet
    std::uint64_t taken;       // bytes of its windows that it has ever taken
    std::uint64_t may_become;  // upper bound of that
  };
  struct Held {
    std::uint32_t uid;    // not the process's own user
    std::uint64_t bytes;  // of messages that its readers keep
  };
  /// A user above its share, and what that is.
  struct Above {
    std::uint32_t uid;
    std::uint64_t share;
  };
  /// Returns the users whose readers to withdraw, and bans them. Call it about once a second.
  /// `together`: bytes that all `users` keep; a message kept by several counts once. Allocates.
  std::vector<Above> look(Clock::time_point now, const Room& room, std::uint64_t together,
                          std::span<const Held> users);
  /// Instead of look(), if there is no reader of another user.
  void nobody_reads(Clock::time_point now) { above_.look(now, {}); }
  /// Returns whether newcomers of this user are withdrawn at once, and withdrawn readers are not
  /// served again.
  bool is_out(PeerOwner owner, Clock::time_point now) const { return bans_.has(owner, now); }

 private:
  /// Returns whether the heap has refused an allocation since the last look, and could not grow
  /// then.
  bool has_refused(const Room& room) noexcept;

  std::uint64_t refused_ = 0;
  bool may_grow_ = true;                         // at the last look
  std::optional<Clock::time_point> refused_at_;  // the last time, if recent
  UserPatience above_{patience};
  UserBans bans_;
};

}  // namespace agnocast
