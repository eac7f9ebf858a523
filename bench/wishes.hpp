// SPDX-License-Identifier: Apache-2.0
//
// Wishes: the options of a run, with a case's defaults for missing ones.
#pragma once

#include <bench/case.hpp>
#include <bench/lane.hpp>

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <utility>
#include <vector>

namespace agnocast::bench {

class Wishes {
 public:
  explicit Wishes(const Run& run) : run_(run) {}

  bool is_small() const { return run_.is_small; }
  std::size_t rounds(std::size_t usual) const {
    return run_.rounds.value_or(run_.is_small ? 1 : usual);
  }
  /// Returns the sizes, the smallest first.
  std::vector<std::size_t> sizes(std::vector<std::size_t> usual,
                                 std::vector<std::size_t> small) const {
    std::vector<std::size_t> sizes = !run_.sizes.empty() ? run_.sizes
                                     : run_.is_small     ? std::move(small)
                                                         : std::move(usual);
    std::sort(sizes.begin(), sizes.end());
    return sizes;
  }
  /// Completes `plan`, which has the case's defaults: the run's period and messages replace them,
  /// with a tenth as warm-up.
  Plan plan(Plan plan) const {
    if (run_.period) plan.period_ns = run_.period->count() * 1000;
    // At the rate of a LiDAR, 100 ms, a hundred take ten seconds.
    if (plan.period_ns >= 20'000'000) plan.messages = std::min<std::size_t>(plan.messages, 100);
    plan.messages = run_.messages.value_or(run_.is_small ? 20 : plan.messages);
    plan.warm_up = std::max<std::size_t>(plan.messages / 10, 5);
    return plan;
  }

 private:
  const Run& run_;
};

}  // namespace agnocast::bench
