// SPDX-License-Identifier: Apache-2.0
//
// Views: the position of each word in a region, for one endpoint each. No state and no rules; the
// layouts are in abi/.
#pragma once

#include <agnocast/abi/board.hpp>
#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/words.hpp>
#include <base/memory/memory_policy.hpp>

#include <cstddef>
#include <cstdint>

namespace agnocast::region {

/// Words of one publisher endpoint.
template <class M>
struct PublisherWords {
  typename M::Region region;
  std::uint64_t extent;

  decltype(auto) head() const noexcept { return at(offsetof(abi::PublisherEndpoint, head)); }
  decltype(auto) persistent_id() const noexcept {
    return at(offsetof(abi::PublisherEndpoint, persistent_id));
  }
  decltype(auto) inherited() const noexcept {
    return at(offsetof(abi::PublisherEndpoint, inherited));
  }
  decltype(auto) asserted_ns() const noexcept {
    return at(offsetof(abi::PublisherEndpoint, asserted_ns));
  }
  decltype(auto) intent_op() const noexcept {
    return at(offsetof(abi::PublisherEndpoint, intent_op));
  }
  decltype(auto) intent_sequence() const noexcept {
    return at(offsetof(abi::PublisherEndpoint, intent_sequence));
  }
  decltype(auto) intent_slot() const noexcept {
    return at(offsetof(abi::PublisherEndpoint, intent_slot));
  }
  /// Returns the word that contains the withdrawal bits of this subscription of the topic.
  decltype(auto) withdrawn(std::uint64_t subscription) const noexcept {
    return at(offsetof(abi::PublisherEndpoint, withdrawn) +
              subscription / abi::withdrawals_per_word * sizeof(abi::SharedWord));
  }
  /// Returns one of the counters behind the intent.
  decltype(auto) counter(std::size_t field) const noexcept { return at(field); }
  decltype(auto) order(std::uint64_t sequence) const noexcept {
    return at(abi::order_offset(sequence & (M::ring_count() - 1)));
  }
  decltype(auto) slot_id(std::uint64_t slot) const noexcept {
    return at_slot(slot, offsetof(abi::QueueSlot, id));
  }
  decltype(auto) slot_address(std::uint64_t slot) const noexcept {
    return at_slot(slot, offsetof(abi::QueueSlot, address));
  }
  decltype(auto) slot_stamp(std::uint64_t slot) const noexcept {
    return at_slot(slot, offsetof(abi::QueueSlot, stamp_ns));
  }
  decltype(auto) slot_size(std::uint64_t slot) const noexcept {
    return at_slot(slot, offsetof(abi::QueueSlot, size));
  }

 private:
  decltype(auto) at(std::uint64_t offset) const noexcept {
    return M::word(region, extent + offset);
  }
  decltype(auto) at_slot(std::uint64_t slot, std::uint64_t field) const noexcept {
    return at(abi::slot_offset(M::ring_count(), slot) + field);
  }
};

/// Words of one subscription's link to one publisher.
template <class M>
class LinkWords {
 public:
  /// `extent`: of the subscription endpoint; `publisher`: index of the publisher in the topic.
  LinkWords(typename M::Region region, std::uint64_t extent, std::uint64_t publisher) noexcept
      : LinkWords(region, extent + abi::link_offset(publisher)) {}
  /// `line`: offset of its link line in the region.
  LinkWords(typename M::Region region, std::uint64_t line) noexcept
      : region_(region), line_(line) {}

  decltype(auto) publisher_generation() const noexcept {
    return at(offsetof(abi::LinkLine, publisher_generation));
  }
  decltype(auto) cursor() const noexcept { return at(offsetof(abi::LinkLine, cursor)); }
  /// Returns the hold word of slots 64×word … 64×word+63; the first ones share the link line.
  decltype(auto) hold(std::uint64_t word) const noexcept {
    const std::uint64_t near_words = M::near_slot_count() / 64;
    return at(word < near_words ? offsetof(abi::LinkLine, hold) + word * sizeof(abi::SharedWord)
                                : abi::far_hold_offset(word - near_words));
  }

 private:
  decltype(auto) at(std::uint64_t offset) const noexcept {
    return M::word(region_, line_ + offset);
  }

  typename M::Region region_;
  std::uint64_t line_;
};

/// Counters of one subscription, and its persistent endpoint id.
template <class M>
struct SubscriptionWords {
  typename M::Region region;
  std::uint64_t extent;

  decltype(auto) persistent_id() const noexcept {
    return counter(offsetof(abi::SubscriptionCounters, persistent_id));
  }
  decltype(auto) counter(std::size_t field) const noexcept {
    return M::word(region, extent + field);
  }
};

/// Words of one topic on the board.
template <class M>
struct TopicWords {
  typename M::Region board;
  std::uint64_t offset;

  decltype(auto) epoch() const noexcept { return at(offsetof(abi::TopicHeader, epoch)); }
  decltype(auto) publisher_high() const noexcept {
    return at(offsetof(abi::TopicHeader, publisher_high));
  }
  decltype(auto) subscription_high() const noexcept {
    return at(offsetof(abi::TopicHeader, subscription_high));
  }
  decltype(auto) publisher(std::uint64_t index, std::size_t field) const noexcept {
    return at(abi::publisher_entry_offset(index) + field);
  }
  decltype(auto) subscription(std::uint64_t index, std::size_t field) const noexcept {
    return at(abi::subscription_entry_offset(M::publisher_count(), index) + field);
  }

 private:
  decltype(auto) at(std::uint64_t field) const noexcept { return M::word(board, offset + field); }
};

/// Returns a - b, at least floor: for sequence numbers near the start of a generation.
constexpr std::uint64_t minus_at_least(std::uint64_t a, std::uint64_t b,
                                       std::uint64_t floor) noexcept {
  return a < b || a - b < floor ? floor : a - b;
}

}  // namespace agnocast::region
