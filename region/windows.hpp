// SPDX-License-Identifier: Apache-2.0
//
// Frontiers: how far a heap window is in use. The owner stores a grown frontier, as
// dataplane/frontier.hpp does, before it commits a message that lies beyond the old one; a taker
// loads the frontiers behind its hold and opens its mapping up to them, so that every pointer inside
// the message is covered, not only the message object. docs/protocol.md T6.
//
// Windows come in groups, and a message lies in windows of one group only: so a process that cannot
// map one window knows which messages might point there. The owner begins a group by allocating from
// its first window alone.
#pragma once

#include <region/views.hpp>

#include <cstddef>
#include <cstdint>

namespace agnocast::region {

/// What T6 finds out about the place of a message.
enum class Place : std::uint64_t {
  readable,     ///< it lies in an open window, and all windows of the group are open
  awaited,      ///< in a window, or one of its group, that was not announced to this process yet
  unreachable,  ///< this process cannot map a window of the group: something else lies there
  outside,      ///< nowhere in the owner's heap
};

template <class M>
decltype(auto) frontier_word(typename M::Region client_region, std::uint64_t window) noexcept {
  return M::word(client_region, offsetof(abi::ClientRegionHeader, window) +
                                    window * sizeof(abi::WindowEntry) +
                                    offsetof(abi::WindowEntry, frontier));
}

/// Reader. What the owner claims, clamped to the window's length as the daemon announced it.
template <class M>
std::uint64_t load_frontier(typename M::Region client_region, std::uint64_t window,
                            std::uint64_t length) noexcept {
  const std::uint64_t claimed =
      frontier_word<M>(client_region, window).load(std::memory_order_acquire);
  return claimed < length ? claimed : length;
}

}  // namespace agnocast::region
