// SPDX-License-Identifier: Apache-2.0
//
// Start steps: where a subscription begins to read a publisher that was there before it.
// docs/protocol.md, "Join, leave, death".
#pragma once

#include <journal/steps.hpp>
#include <region/views.hpp>

#include <cstdint>

namespace agnocast::journal {

/// J4, behind J3 and before the answer to the subscription's process: the subscription begins with
/// what `publisher` commits from now on, however long its process takes to link. `line` is not
/// linked. May be repeated until then; the subscription begins later by it.
template <class M>
void set_start(const region::PublisherWords<M>& publisher,
               const region::LinkWords<M>& line) noexcept {
  std::uint64_t head = 0;
  // [sync:join] seq_cst; behind J3 in the single total order, so a publisher that missed J3 has
  // committed nothing behind this head.
  AGNOCAST_STEP(J4_head) head = publisher.head().load(std::memory_order_seq_cst);
  AGNOCAST_STEP(J4_start)
  line.cursor().store(abi::sequence_of(head) + 1, std::memory_order_release);
}

}  // namespace agnocast::journal
