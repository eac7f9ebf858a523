// SPDX-License-Identifier: Apache-2.0
//
// Bare calls: what publish, take and release cost by themselves when nobody has to be woken, beside an uncontended lock and
// unlock of a mutex and one reading of the clock, measured in the same process by turns.
#pragma once

#include <bench/services.hpp>

#include <cstddef>
#include <functional>
#include <vector>

namespace agnocast::bench {

/// Medians over the rounds of each round's mean.
struct BareCalls {
  double mutex_clock_ns = 0, publish_ns = 0, take_ns = 0;
  std::vector<double> publish_ratios, take_ratios;  ///< of each round, to its mutex and clock
};

/// A process for each round; `step` is called before each. Throws std::runtime_error.
BareCalls measure_bare_calls(std::size_t rounds, std::size_t batches, Services& services,
                             const std::function<void()>& step);

}  // namespace agnocast::bench
