// SPDX-License-Identifier: Apache-2.0
//
// The owner's half of a frontier; the reader's half, and what a frontier is: region/windows.hpp.
#pragma once

#include <base/memory_policy.hpp>
#include <dataplane/steps.hpp>
#include <region/windows.hpp>

#include <cstdint>

namespace agnocast::dataplane {

/// Owner. Called by whoever grows the heap, before any address beyond the old frontier is handed
/// out.
template <class M>
void store_frontier(typename M::Region client_region, std::uint64_t window,
                    std::uint64_t bytes) noexcept {
  // [sync:frontier] release; the commit (P5) that follows publishes it, T1 acquires that, T6 reads
  // it.
  AGNOCAST_STEP(P0_frontier)
  region::frontier_word<M>(client_region, window).store(bytes, std::memory_order_release);
}

}  // namespace agnocast::dataplane
