// SPDX-License-Identifier: Apache-2.0
//
// HoldPool: how many messages of a publisher the subscriptions of other users may hold. Pure.
//
// A publisher goes on as long as it has a slot. Of its slots it needs itself the longest history
// that anybody may ask for, and what is in hand; the rest is what subscriptions hold:
//
//   |<---------------------------- slots_per_publisher (2048) ----------------------------->|
//   |  history and in hand (1035)  |  one for each subscription (768)  |  pool (245)        |
//
// Every subscription may hold one message, so nobody can be kept from reading. More than one comes
// from the pool, of which a user may have half of what other users have left: who comes later finds
// something, too. All three are constants of the configuration, so the sum holds for every
// publisher, whoever's it is and whenever it comes. Subscriptions of the publisher's own user are
// not limited here: what they hold beyond the share of others is a matter of that user.
#pragma once

#include <agnocast/abi/limits.hpp>

#include <algorithm>
#include <cstdint>

namespace agnocast::daemon {

// One for the message being published and one for the one being borrowed.
inline constexpr std::uint64_t slots_in_hand = 2;
// What a publisher needs beside a history of some depth: a keep-all one has one message more.
inline constexpr std::uint64_t slots_beside_history =
    1 + abi::deferred_scan_count_max + slots_in_hand;

class HoldPool {
 public:
  /// `used` of the subscriptions there are: what they may hold beyond the one.
  struct Use {
    std::uint64_t user = 0;    // of the user who asks
    std::uint64_t others = 0;  // of everybody else
  };

  constexpr HoldPool(std::uint64_t slots, std::uint64_t depth_max,
                     std::uint64_t subscriptions) noexcept {
    const std::uint64_t needed = depth_max + slots_beside_history + subscriptions;
    size_ = slots > needed ? slots - needed : 0;
  }

  constexpr std::uint64_t size() const noexcept { return size_; }

  /// The largest quota that one more subscription can have.
  constexpr std::uint64_t at_most(const Use& use) const noexcept { return 1 + left(use); }
  /// The quota of one that asks for `asked` or less, without a reason for this number: an eighth of
  /// what is left, so that a user has something for some dozens of them.
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
              245);

}  // namespace agnocast::daemon
