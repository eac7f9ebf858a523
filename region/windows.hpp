// SPDX-License-Identifier: Apache-2.0
//
// Frontiers: the used part of a heap window. The owner stores a grown frontier
// (dataplane/frontier.hpp) before it commits a message beyond the old one; a taker loads the
// frontiers behind its hold and opens its mapping up to them, so that the mapping covers every
// pointer inside the message, not only the message object. docs/protocol.md T6.
//
// Windows belong to window sets, and a message lies in windows of one set only: so a process that
// cannot map one window knows which messages might point there. The owner begins a set by
// allocating from its first window alone.
#pragma once

#include <region/views.hpp>

#include <cstddef>
#include <cstdint>

namespace agnocast::region {

/// Result of T6 about the place of a message.
enum class Place : std::uint64_t {
  readable,     ///< in an open window, and all windows of the set are open
  awaited,      ///< in a window, or one of its set, that was not announced to this process yet
  unreachable,  ///< this process cannot map a window of the set: its addresses are in use
  outside,      ///< not in the owner's heap
};

template <class M>
decltype(auto) frontier_word(typename M::Region client_region, std::uint64_t window) noexcept {
  return M::word(client_region, offsetof(abi::ClientRegionHeader, window) +
                                    window * sizeof(abi::WindowEntry) +
                                    offsetof(abi::WindowEntry, frontier));
}

/// Reader. Returns the owner's frontier, clamped to the window's length in the daemon's
/// announcement.
template <class M>
std::uint64_t load_frontier(typename M::Region client_region, std::uint64_t window,
                            std::uint64_t length) noexcept {
  const std::uint64_t claimed =
      frontier_word<M>(client_region, window).load(std::memory_order_acquire);
  return claimed < length ? claimed : length;
}

}  // namespace agnocast::region
