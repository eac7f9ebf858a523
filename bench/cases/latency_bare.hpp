// SPDX-License-Identifier: Apache-2.0
//
// Bare calls: the cost of borrow, publish, take and release by themselves without a wake-up,
// beside an uncontended lock and unlock of a mutex and one reading of the clock, measured
// alternately in the same process.
#pragma once

#include <bench/services.hpp>

#include <cstddef>
#include <functional>
#include <vector>

namespace agnocast::bench {

struct BareCall {
  const char* name;
  bool is_judged = false;
  std::vector<double> ns = {};      ///< per round, the median of its batches
  std::vector<double> ratios = {};  ///< the same, relative to the round's mutex and clock
};
struct BareCalls {
  double mutex_clock_ns = 0;    ///< median over the rounds
  std::vector<BareCall> calls;  ///< individually, and all of them together
};

/// Runs a process for each round; calls `step` before each. Throws std::runtime_error.
BareCalls measure_bare_calls(std::size_t rounds, std::size_t batches, Services& services,
                             const std::function<void()>& step);

}  // namespace agnocast::bench
