// SPDX-License-Identifier: Apache-2.0
//
// ReaderShares: what readers of other users may keep of this process's heap while it is full.
//
// How many messages others may hold is decided when they subscribe; how large those are nobody knows
// then. When the heap refuses an allocation, one user's readers that keep a quarter of what is in use, or most
// when those of all other users together keep half, have a few seconds. If the heap refuses another one
// then and they still do, this process serves those of them no more that keep most
// (PublisherCore::withdraw), and newcomers of that user for a while neither: they would begin anew.
// A process's own user is in no share.
//
//   an allocation is refused, somebody is over the share → patience → another one is → withdrawn → patience
//   → disregarded
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <span>

namespace agnocast {

class ReaderShares {
 public:
  using Clock = std::chrono::steady_clock;
  /// What an honest reader needs to let go of what it is busy with, and of what it need not: after each
  /// step of the way there is as much time.
  static constexpr std::chrono::seconds patience{5};
  /// Subscriptions that the daemon tells of late are served again; that is rare, and messages are lost.
  static constexpr std::chrono::seconds patience_to_attach{10};
  static constexpr std::chrono::seconds out_for{60};
  /// What one user's readers may keep of a full heap, however many publishers have it.
  static constexpr std::uint64_t one_user_of(std::uint64_t heap_bytes) noexcept {
    return heap_bytes / 4;
  }

  struct Held {
    std::uint32_t uid;
    std::uint64_t bytes;  // of messages that stay because of its readers
  };
  /// Once a second or so. `refused`: allocations that found no room, since ever. The user from whose readers
  /// to withdraw, if any. Allocates.
  std::optional<std::uint32_t> look(Clock::time_point now, std::uint64_t refused,
                                    std::uint64_t heap_bytes, std::span<const Held> users);
  /// Instead of a look: nobody holds anything.
  void nobody_holds() noexcept { over_since_.reset(); }
  /// Newcomers of this user are withdrawn at once.
  bool is_out(std::uint32_t uid, Clock::time_point now) const;

 private:
  std::uint64_t refused_ = 0;
  std::optional<Clock::time_point>
      over_since_;  // the first refusal while somebody was over its share
  std::map<std::uint32_t, Clock::time_point> out_until_;
};

}  // namespace agnocast
