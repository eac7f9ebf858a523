// SPDX-License-Identifier: Apache-2.0
//
// The roles of the soak's processes. Both run in a forked child that has never used the library.
#pragma once

#include <tests/system/soak_board.hpp>

namespace agnocast::test {

/// Lives until it is killed: joins with a few publishers and subscriptions of random kinds, uses
/// them, creates and destroys them, and may leave properly.
[[noreturn]] void run_mayfly(SoakBoard& board, SoakPlace& place, std::uint64_t seed);

/// Joins before all others and is never killed, with a subscription and a publisher on every
/// topic. It accounts for every committed message and goes through the phases of the board.
[[noreturn]] void run_resident(SoakBoard& board, SoakPlace& place, std::uint64_t seed);

}  // namespace agnocast::test
