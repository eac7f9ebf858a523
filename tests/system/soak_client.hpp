// SPDX-License-Identifier: Apache-2.0
//
// What the processes of the soak do. Both run in a forked child that has never used the library.
#pragma once

#include <tests/system/soak_board.hpp>

namespace agnocast::test {

/// Lives until it is killed: joins with a few publishers and subscriptions of random kinds, uses
/// them, lets them come and go, and may leave properly.
[[noreturn]] void run_mayfly(SoakBoard& board, SoakPlace& place, std::uint64_t seed);

/// Is there before everybody else and never killed, with a subscription and a publisher on every
/// topic. It accounts for every message that anybody committed; goes through the phases of the board.
[[noreturn]] void run_resident(SoakBoard& board, SoakPlace& place, std::uint64_t seed);

}  // namespace agnocast::test
