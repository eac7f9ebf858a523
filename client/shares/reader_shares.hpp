// SPDX-License-Identifier: Apache-2.0
//
// ReaderShares: what readers of other users may keep of this process's heap. Pure.
//
// How many messages others may hold is decided when they subscribe; how large those are nobody knows then. So the
// control thread looks once a second, in two cases:
//   - the heap, which could not grow any more, has refused an allocation within the last minute: readers of all other
//     users may keep half of what the heap has ever taken of its windows, which is all that a full heap can have;
//   - it has not, but readers of other users keep half of what it may become. That counts as no more than a quarter
//     of the machine's memory (client/shares/machine_memory.hpp): a heap may usually become larger than that, and the
//     system would kill somebody before the heap refuses anything. So the processes of eight publishers whose readers
//     all keep what they may fill the memory, and one of them an eighth.
// Of that half one user has half at most, and where it does not suffice, none more than an equal part: what those
// leave who keep less is the others'. Each user that is above has a few seconds of its own, in looks that need not follow
// each other (UserPatience). When a user is above after that, and the heap has refused another allocation or is still
// beyond what it may become, this process serves no more, all in one look, those of such users' readers that keep most
// (PublisherCore::withdraw), and newcomers of these users for a while neither (UserBans): they would begin anew. A user
// that is above for the first time keeps its seconds, however long others were. A publisher that is refused more rarely
// than once a minute begins anew each time: nothing says what its heap was in between. A process's own user is in no
// share.
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
  /// What an honest reader needs to let go of what it is busy with, and of what it need not: after each
  /// step of the way there is as much time.
  static constexpr std::chrono::seconds patience{5};
  /// After the last refusal a heap counts as full for so long.
  static constexpr std::chrono::seconds full_for{60};
  /// Subscriptions that the daemon tells of late are served again; that is rare, and messages are lost.
  static constexpr std::chrono::seconds patience_to_attach{10};

  struct Room {
    std::uint64_t refused;     // allocations that found no room, since ever
    bool may_grow;             // one more window was not refused, or not asked for yet
    std::uint64_t taken;       // bytes of its windows that it has ever taken
    std::uint64_t may_become;  // likewise, at most
  };
  struct Held {
    std::uint32_t uid;    // not the process's own user
    std::uint64_t bytes;  // of messages that stay because of its readers
  };
  /// A user above its share, and what that is.
  struct Above {
    std::uint32_t uid;
    std::uint64_t share;
  };
  /// Returns the users from whose readers to withdraw, which are banned from now on. Once a second or so. `together`:
  /// bytes that all `users` keep; a message that several of them keep counts once. Allocates.
  std::vector<Above> look(Clock::time_point now, const Room& room, std::uint64_t together,
                          std::span<const Held> users);
  /// Instead of a look: no reader of another user is there.
  void nobody_reads(Clock::time_point now) { above_.look(now, {}); }
  /// Newcomers of this user are withdrawn at once, and who was withdrawn is not served again.
  bool is_out(PeerOwner owner, Clock::time_point now) const { return bans_.has(owner, now); }

 private:
  /// Returns whether the heap has refused an allocation since the last look, and could not grow then.
  bool has_refused(const Room& room) noexcept;

  std::uint64_t refused_ = 0;
  bool may_grow_ = true;                         // at the last look
  std::optional<Clock::time_point> refused_at_;  // the last time, if that is not long ago
  UserPatience above_{patience};
  UserBans bans_;
};

}  // namespace agnocast
