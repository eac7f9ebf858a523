// SPDX-License-Identifier: Apache-2.0
//
// Figures of samples: quantiles, spread, intervals, a straight line. Header only, values in,
// values out.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <random>
#include <utility>
#include <vector>

namespace agnocast::bench {

/// Returns the q-quantile (0 … 1) by linear interpolation between order statistics (type 7 of
/// Hyndman and Fan, 1996); 0 for no samples. The median is quantile(…, 0.5).
inline double quantile(std::vector<double> samples, double q) {
  if (samples.empty()) return 0;
  std::sort(samples.begin(), samples.end());
  const double place = q * static_cast<double>(samples.size() - 1);
  const auto below = static_cast<std::size_t>(place);
  const std::size_t above = std::min(below + 1, samples.size() - 1);
  return samples[below] + (place - static_cast<double>(below)) * (samples[above] - samples[below]);
}
inline double median(std::vector<double> samples) { return quantile(std::move(samples), 0.5); }

/// With fewer samples the 0.99-quantile is nearly their maximum, so no p99 is printed.
inline constexpr std::size_t p99_samples_min = 100;

inline double mean(const std::vector<double>& samples) {
  if (samples.empty()) return 0;
  return std::accumulate(samples.begin(), samples.end(), 0.0) / static_cast<double>(samples.size());
}
/// Returns the coefficient of variation: the sample's standard deviation over its mean; 0 below
/// two samples.
inline double variation(const std::vector<double>& samples) {
  const double middle = mean(samples);
  if (samples.size() < 2 || middle == 0) return 0;
  double squares = 0;
  for (const double sample : samples) squares += (sample - middle) * (sample - middle);
  return std::sqrt(squares / static_cast<double>(samples.size() - 1)) / middle;
}

struct Interval {
  double low = 0, high = 0;
};
/// Returns the 95 % interval of `statistic` by the percentile bootstrap (Efron 1979), `resamples`
/// drawings with a fixed seed.
template <typename Statistic>
Interval bootstrap(const std::vector<double>& samples, Statistic statistic,
                   std::size_t resamples = 1000) {
  if (samples.empty()) return {};
  std::mt19937_64 random(1);
  std::uniform_int_distribution<std::size_t> any(0, samples.size() - 1);
  std::vector<double> drawn(samples.size()), statistics;
  for (std::size_t i = 0; i < resamples; ++i) {
    for (double& sample : drawn) sample = samples[any(random)];
    statistics.push_back(statistic(drawn));
  }
  return {quantile(statistics, 0.025), quantile(statistics, 0.975)};
}

/// Returns the 95 % interval of statistic(one) / statistic(other) for samples taken in rounds,
/// each round of both under the same conditions. Samples of a round are alike, so it draws
/// rounds, the same for both, and then samples within each, and applies the statistic to their
/// union.
template <typename Statistic>
Interval bootstrap_ratio(const std::vector<std::vector<double>>& one,
                         const std::vector<std::vector<double>>& other, Statistic statistic,
                         std::size_t resamples = 1000) {
  const std::size_t rounds = std::min(one.size(), other.size());
  if (rounds == 0) return {};
  std::mt19937_64 random(1);
  const auto any_below = [&](std::size_t end) {
    return std::uniform_int_distribution<std::size_t>(0, end - 1)(random);
  };
  const auto draw = [&](const std::vector<double>& from, std::vector<double>& to) {
    for (std::size_t i = 0; i < from.size(); ++i) to.push_back(from[any_below(from.size())]);
  };
  std::vector<double> ratios;
  for (std::size_t i = 0; i < resamples; ++i) {
    std::vector<double> of_one, of_other;
    for (std::size_t j = 0; j < rounds; ++j) {
      const std::size_t round = any_below(rounds);
      draw(one[round], of_one);
      draw(other[round], of_other);
    }
    ratios.push_back(statistic(of_one) / statistic(of_other));
  }
  return {quantile(ratios, 0.025), quantile(ratios, 0.975)};
}

/// Returns the 95 % interval of the median by order statistics: cuts off as many samples at both
/// ends as the confidence permits. For seven samples it is from the least to the greatest (98.4
/// %); likewise below six, where no interval is as certain.
inline Interval median_interval(std::vector<double> samples) {
  if (samples.empty()) return {};
  std::sort(samples.begin(), samples.end());
  const std::size_t count = samples.size();
  // Probability of `cut` heads of a fair coin, and of `cut` at most.
  double exactly = std::pow(0.5, static_cast<double>(count)), at_most = exactly;
  std::size_t cut = 0;
  for (;;) {
    exactly *= static_cast<double>(count - cut) / static_cast<double>(cut + 1);
    at_most += exactly;
    if (2 * at_most > 0.05 || 2 * (cut + 1) >= count) break;
    ++cut;
  }
  return {samples[cut], samples[count - 1 - cut]};
}

/// y = offset + slope · x, by least squares; a constant if there is only one x.
struct Line {
  double slope = 0, offset = 0;
};
inline Line line_through(const std::vector<double>& x, const std::vector<double>& y) {
  const auto count = static_cast<double>(x.size());
  double mean_x = 0, mean_y = 0, across = 0, along = 0;
  for (std::size_t i = 0; i < x.size(); ++i) mean_x += x[i] / count, mean_y += y[i] / count;
  for (std::size_t i = 0; i < x.size(); ++i) {
    across += (x[i] - mean_x) * (y[i] - mean_y);
    along += (x[i] - mean_x) * (x[i] - mean_x);
  }
  const double slope = along == 0 ? 0 : across / along;
  return {slope, mean_y - slope * mean_x};
}

}  // namespace agnocast::bench
