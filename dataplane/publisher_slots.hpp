// SPDX-License-Identifier: Apache-2.0
//
// Publisher slots: which slots of its queue a publisher has allocated, and what lies in each.
// Private memory of the process; the publisher core stores what peers see of a slot
// (dataplane/publisher_core.hpp).
//
//   free ──enter──▶ allocated ──retire──▶ retired ──free──▶ free
//                       └───────free──────────────────────────▲
#pragma once

#include <region/views.hpp>

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

namespace agnocast::dataplane {

template <class M>
class PublisherSlots {
 public:
  static constexpr std::uint64_t none = ~std::uint64_t{0};
  static constexpr std::size_t mask_words = (M::slot_capacity + 63) / 64;
  using Mask = std::array<std::uint64_t, mask_words>;  // a bit for each slot

  explicit PublisherSlots(std::uint64_t count) : count_(count) {}
  /// Raises the number of slots that may be used; it never falls.
  void grow(std::uint64_t count) noexcept {
    count_ = std::clamp<std::uint64_t>(count, count_, M::slot_capacity);
  }

  static bool test(const Mask& mask, std::uint64_t slot) noexcept {
    return (mask[slot / 64] >> slot % 64 & 1) != 0;
  }
  /// Returns how many words of a mask have slots of this publisher; nothing is allocated beyond
  /// them.
  std::size_t words_in_use() const noexcept { return (static_cast<std::size_t>(count_) + 63) / 64; }
  std::uint64_t allocated(std::size_t word) const noexcept { return allocated_[word]; }
  bool is_retired(std::uint64_t slot) const noexcept { return test(retired_, slot); }
  std::uint64_t sequence(std::uint64_t slot) const noexcept { return facts_->sequence[slot]; }
  std::uint64_t address(std::uint64_t slot) const noexcept { return facts_->address[slot]; }
  std::uint64_t bytes(std::uint64_t slot) const noexcept { return facts_->bytes[slot]; }
  /// Returns how many are allocated.
  std::uint64_t count() const noexcept {
    std::uint64_t count = 0;
    for (std::uint64_t word : allocated_) count += static_cast<std::uint64_t>(std::popcount(word));
    return count;
  }
  /// Calls `function` for each allocated slot; it may free that slot.
  template <class Function>
  void for_each(Function function) const noexcept {
    const std::size_t words = words_in_use();
    for (std::size_t word = 0; word < words; ++word) {
      for (std::uint64_t bits = allocated_[word]; bits != 0; bits &= bits - 1) {
        function(word * 64 + static_cast<std::uint64_t>(std::countr_zero(bits)));
      }
    }
  }
  /// Returns whether a message with a lower sequence number is allocated.
  bool has_before(std::uint64_t sequence) const noexcept {
    bool found = false;
    for_each([&](std::uint64_t slot) { found = found || facts_->sequence[slot] < sequence; });
    return found;
  }
  /// Returns the lowest free slot, or `none` if all are allocated.
  std::uint64_t lowest_free() const noexcept {
    const std::size_t words = words_in_use();
    for (std::size_t word = 0; word < words; ++word) {
      if (~allocated_[word] == 0) continue;
      const std::uint64_t slot =
          word * 64 + static_cast<std::uint64_t>(std::countr_one(allocated_[word]));
      return slot < count_ ? slot : none;
    }
    return none;
  }

  void enter(std::uint64_t slot, std::uint64_t sequence, std::uint64_t address,
             std::uint64_t bytes) noexcept {
    facts_->sequence[slot] = sequence;
    facts_->address[slot] = address;
    facts_->bytes[slot] = bytes;
    set(allocated_, slot);
  }
  void retire(std::uint64_t slot) noexcept { set(retired_, slot); }
  void free(std::uint64_t slot) noexcept {
    clear(allocated_, slot);
    clear(retired_, slot);
  }

  // --- what peers hold of them

  /// Returns the bits of this word that belong to messages up to this sequence number: a withdrawn
  /// endpoint has taken no later ones, whatever its bits say.
  std::uint64_t published_before(std::uint64_t sequence, std::size_t word,
                                 std::uint64_t bits) const noexcept {
    std::uint64_t kept = 0;
    for (std::uint64_t left = bits & allocated_[word]; left != 0; left &= left - 1) {
      const std::uint64_t slot = word * 64 + static_cast<std::uint64_t>(std::countr_zero(left));
      if (facts_->sequence[slot] <= sequence) kept |= left & -left;
    }
    return kept;
  }

  /// Returns whether an endpoint holds more of them than its quota. One look cannot decide: while
  /// it lasts, messages are released and others taken. Only bits that all three looks find count.
  /// An honest subscription takes one message after the other, and none at its quota, so at no
  /// moment has it more bits than that. If more were set in all looks, a bit A would be clear
  /// between the first two looks and set by a take (T4) before the third. That take begins below
  /// the quota: another bit B is clear then, which the first look has found and the third will
  /// find. So takes have cleared A and B and set them again later; a released message is not taken
  /// again. A take clears its bit
  ///   - at T5, for the slot's previous message. Nothing is published or freed during a scan, so
  ///     only the take that was under way when the scan began does that: the first of the scan;
  ///   - at T6, and leaves its message unread. The next take is of that message, later takes are of
  ///     newer ones.
  /// So A was cleared at T6 and B at T5. The other way round, or with both at T6, the take that
  /// sets A would be of a newer message than B's, and no take would set B again. Then the take that
  /// sets B begins below the quota as well, and a third bit has to be clear that is set again
  /// later: there is none.
  bool holds_too_many(const region::LinkWords<M>& link, std::uint64_t quota) const noexcept {
    Mask all = allocated_;
    for (int look = 0; look < 3; ++look) {
      for (std::size_t word = 0; word < words_in_use(); ++word) {
        if (all[word] != 0) all[word] &= link.hold(word).load(std::memory_order_acquire);
      }
    }
    std::uint64_t count = 0;
    for (std::size_t word = 0; word < words_in_use(); ++word)
      count += static_cast<std::uint64_t>(std::popcount(all[word]));
    return count > quota;
  }

 private:
  static void set(Mask& mask, std::uint64_t slot) noexcept {
    mask[slot / 64] |= std::uint64_t{1} << slot % 64;
  }
  static void clear(Mask& mask, std::uint64_t slot) noexcept {
    mask[slot / 64] &= ~(std::uint64_t{1} << slot % 64);
  }

  std::uint64_t count_;
  Mask allocated_{};
  Mask retired_{};
  struct Facts {
    std::array<std::uint64_t, M::slot_capacity> sequence, address, bytes;
  };
  typename M::template Zeroed<Facts> facts_;
};

}  // namespace agnocast::dataplane
