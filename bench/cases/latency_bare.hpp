// SPDX-License-Identifier: Apache-2.0
//
// Bare calls: what borrow, publish, take and release cost by themselves when nobody has to be woken, beside an uncontended
// lock and unlock of a mutex and one reading of the clock, measured in the same process by turns.
#pragma once

#include <bench/services.hpp>

#include <cstddef>
#include <functional>
#include <vector>

namespace agnocast::bench {

struct BareCall {
  const char* name;
  bool is_judged = false;
  std::vector<double> ns = {};      ///< of each round, the median of its batches
  std::vector<double> ratios = {};  ///< the same, to the round's mutex and clock
};
struct BareCalls {
  double mutex_clock_ns = 0;    ///< median over the rounds
  std::vector<BareCall> calls;  ///< one by one, and all of them together
};

/// A process for each round; `step` is called before each. Throws std::runtime_error.
BareCalls measure_bare_calls(std::size_t rounds, std::size_t batches, Services& services,
                             const std::function<void()>& step);

}  // namespace agnocast::bench
