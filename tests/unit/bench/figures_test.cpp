// SPDX-License-Identifier: Apache-2.0
//
// Goal: statistics match their definitions. Method: samples whose statistics are known by hand.

#include <bench/figures.hpp>

#include <gtest/gtest.h>

#include <vector>

namespace agnocast::bench {
namespace {

TEST(Figures, QuantilesLieBetweenOrderStatistics) {
  EXPECT_DOUBLE_EQ(median({3, 1, 2}), 2);
  EXPECT_DOUBLE_EQ(median({4, 1, 3, 2}), 2.5);
  EXPECT_DOUBLE_EQ(quantile({10, 20, 30, 40, 50}, 0.9), 46);
  EXPECT_DOUBLE_EQ(quantile({10, 20, 30}, 1), 30);
  EXPECT_DOUBLE_EQ(quantile({}, 0.5), 0);
}

TEST(Figures, VariationIsTheSamplesDeviationOverItsMean) {
  EXPECT_DOUBLE_EQ(variation({1, 3}), std::sqrt(2.0) / 2);
  EXPECT_DOUBLE_EQ(variation({5}), 0);
}

TEST(Figures, BootstrapOfEqualSamplesIsAPoint) {
  const Interval interval = bootstrap({7, 7, 7}, [](const auto& drawn) { return median(drawn); });
  EXPECT_DOUBLE_EQ(interval.low, 7);
  EXPECT_DOUBLE_EQ(interval.high, 7);
}

TEST(Figures, BootstrapOfARatioKeepsRoundsPaired) {
  const auto middle = [](const std::vector<double>& drawn) { return median(drawn); };
  // One system that always takes half of the other's time.
  const Interval certain = bootstrap_ratio({{2, 2}, {2, 2}}, {{4}, {4}}, middle);
  EXPECT_DOUBLE_EQ(certain.low, 0.5);
  EXPECT_DOUBLE_EQ(certain.high, 0.5);
  // A disturbance of a round affects both systems, so the same round is drawn for both.
  const Interval paired = bootstrap_ratio({{1}, {100}}, {{2}, {200}}, middle);
  EXPECT_DOUBLE_EQ(paired.low, 0.5);
  EXPECT_DOUBLE_EQ(paired.high, 0.5);
  // Samples within a round are drawn too.
  const Interval wide = bootstrap_ratio({{1, 9}}, {{1}}, middle);
  EXPECT_DOUBLE_EQ(wide.low, 1);
  EXPECT_DOUBLE_EQ(wide.high, 9);
}

TEST(Figures, IntervalOfAMedianIsBetweenOrderStatistics) {
  std::vector<double> samples;
  const auto of_first = [&](std::size_t count) {
    samples.clear();
    for (std::size_t i = count; i > 0; --i) samples.push_back(static_cast<double>(i));
    const Interval interval = median_interval(samples);
    return std::pair(interval.low, interval.high);
  };
  EXPECT_EQ(of_first(1), std::pair(1.0, 1.0));
  EXPECT_EQ(of_first(3), std::pair(1.0, 3.0));
  // From the tables of the sign test: 98.4, 96.1, 96.1, 97.9, 95.9 %.
  EXPECT_EQ(of_first(7), std::pair(1.0, 7.0));
  EXPECT_EQ(of_first(9), std::pair(2.0, 8.0));
  EXPECT_EQ(of_first(10), std::pair(2.0, 9.0));
  EXPECT_EQ(of_first(20), std::pair(6.0, 15.0));
  EXPECT_EQ(of_first(100), std::pair(40.0, 61.0));
}

TEST(Figures, LineOfLeastSquares) {
  const Line exact = line_through({1, 2, 4}, {5, 7, 11});
  EXPECT_DOUBLE_EQ(exact.slope, 2);
  EXPECT_DOUBLE_EQ(exact.offset, 3);
  // Through (0, 0), (1, 2), (2, 1): slope 1/2 through the mean (1, 1).
  const Line between = line_through({0, 1, 2}, {0, 2, 1});
  EXPECT_DOUBLE_EQ(between.slope, 0.5);
  EXPECT_DOUBLE_EQ(between.offset, 0.5);
  EXPECT_DOUBLE_EQ(line_through({3}, {8}).offset, 8);
}

}  // namespace
}  // namespace agnocast::bench
