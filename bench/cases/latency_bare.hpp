// SPDX-License-Identifier: Apache-2.0
//
// Bare calls: what publish, take and release cost by themselves when nobody has to be woken, beside an uncontended lock and
// unlock of a mutex and one reading of the clock, measured in the same process by turns.
#pragma once

#include <bench/services.hpp>

#include <cstddef>
#include <functional>

namespace agnocast::bench {

/// Medians over the rounds.
struct BareCalls {
  double mutex_clock_ns = 0, publish_ns = 0, take_ns = 0;
  double publish_ratio = 0, take_ratio = 0;  ///< to mutex_clock_ns of the same round
};

/// A process for each round; `step` is called before each. Throws std::runtime_error.
BareCalls measure_bare_calls(std::size_t rounds, std::size_t batches, Services& services,
                             const std::function<void()>& step);

}  // namespace agnocast::bench
