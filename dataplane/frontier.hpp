// SPDX-License-Identifier: Apache-2.0
//
// The owner's side of a frontier. The reader's side, and the definition: region/windows.hpp.
#pragma once

#include <base/memory/memory_policy.hpp>
#include <dataplane/steps.hpp>
#include <region/windows.hpp>

#include <cstdint>

namespace agnocast::dataplane {

/// Owner: stores a grown frontier. The code that grows the heap calls it before it returns any
/// address beyond the old frontier.
template <class M>
void store_frontier(typename M::Region client_region, std::uint64_t window,
                    std::uint64_t bytes) noexcept {
  // [sync:frontier] release; the commit (P5) that follows publishes it, T1 acquires that, T6
  // reads it.
  AGNOCAST_STEP(P0_frontier)
  region::frontier_word<M>(client_region, window).store(bytes, std::memory_order_release);
}

}  // namespace agnocast::dataplane
