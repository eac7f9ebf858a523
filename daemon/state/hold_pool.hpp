// SPDX-License-Identifier: Apache-2.0
//
// HoldPool: how many messages of a publisher the subscriptions of other users may hold. Pure.
//
// A publisher can publish as long as it has a free slot. It needs slots for the longest history
// that a subscription may ask for and for the messages in hand; subscriptions hold the rest:
//
//   |<---------------------------- slots_per_publisher (4096) ----------------------------->|
//   |  history and in hand (1035)  |  one for each subscription (2048)  |  pool (1013)      |
//
// Every subscription may hold one message, so no user can keep another from reading. Further
// messages come from the pool. A user may have half of what other users have left in it, so later
// users find something too. All three parts are constants of the configuration, so the sum holds
// for every publisher of any user. Subscriptions of the publisher's own user are not limited here:
// a user may exhaust its own publishers.
#pragma once

#include <agnocast/abi/limits.hpp>

#include <algorithm>
#include <cstdint>

namespace agnocast::daemon {

// One for the message being published and one for the one being borrowed.
inline constexpr std::uint64_t slots_in_hand = 2;
// Slots that a publisher needs beside a history of some depth; keep-all needs one more.
inline constexpr std::uint64_t slots_beside_history =
    1 + abi::deferred_scan_count_max + slots_in_hand;

class HoldPool {
 public:
  /// Messages of the pool that existing subscriptions may hold, beyond the one that each has.
  struct Use {
    std::uint64_t user = 0;    // by the user that asks
    std::uint64_t others = 0;  // by all other users
  };

  constexpr HoldPool(std::uint64_t slots, std::uint64_t depth_max,
                     std::uint64_t subscriptions) noexcept {
    const std::uint64_t needed = depth_max + slots_beside_history + subscriptions;
    size_ = slots > needed ? slots - needed : 0;
  }

  constexpr std::uint64_t size() const noexcept { return size_; }

  /// Returns the largest quota that one more subscription can have.
  constexpr std::uint64_t at_most(const Use& use) const noexcept { return 1 + left(use); }
  /// Returns the quota of a subscription that asks for at most `asked` and gives no reason for it:
  /// an eighth of what is left, so that a user can have some dozens of them.
  constexpr std::uint64_t part(const Use& use, std::uint64_t asked) const noexcept {
    return std::min(asked, 1 + (left(use) + 7) / 8);
  }

 private:
  constexpr std::uint64_t left(const Use& use) const noexcept {
    const std::uint64_t share = (size_ - std::min(size_, use.others)) / 2;
    return share - std::min(share, use.user);
  }

  std::uint64_t size_ = 0;
};

static_assert(HoldPool(abi::slot_count_max, abi::depth_max, abi::subscription_count_max).size() ==
              1013);

}  // namespace agnocast::daemon
