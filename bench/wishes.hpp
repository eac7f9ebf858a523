// SPDX-License-Identifier: Apache-2.0
//
// Wishes: what a run was asked for, with a case's own defaults behind it.
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
  /// The smallest first.
  std::vector<std::size_t> sizes(std::vector<std::size_t> usual,
                                 std::vector<std::size_t> small) const {
    std::vector<std::size_t> sizes = !run_.sizes.empty() ? run_.sizes
                                     : run_.is_small     ? std::move(small)
                                                         : std::move(usual);
    std::sort(sizes.begin(), sizes.end());
    return sizes;
  }
  /// `plan` has the case's defaults; the run's period and messages replace them, and a tenth comes before as warm-up.
  Plan plan(Plan plan) const {
    if (run_.period) plan.period_ns = run_.period->count() * 1000;
    // A hundred at the pace of a LiDAR, 100 ms, are ten seconds.
    if (plan.period_ns >= 20'000'000) plan.messages = std::min<std::size_t>(plan.messages, 100);
    plan.messages = run_.messages.value_or(run_.is_small ? 20 : plan.messages);
    plan.warm_up = std::max<std::size_t>(plan.messages / 10, 5);
    return plan;
  }

 private:
  const Run& run_;
};

}  // namespace agnocast::bench
