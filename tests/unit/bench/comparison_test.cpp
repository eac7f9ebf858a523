// SPDX-License-Identifier: Apache-2.0
//
// Goal: what is compared is compared within rounds, and an aim is reached only where that can be said. Method: rounds whose
// figures are known by hand.

#include <bench/comparison.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <vector>

namespace agnocast::bench {
namespace {

using testing::ElementsAre;

/// One receiver, and calls that take a tenth of it.
Times round_of(const std::vector<double>& latencies_ns) {
  Times times;
  times.latency_ns = {latencies_ns};
  for (const double ns : latencies_ns) times.publish_ns.push_back(ns / 10);
  return times;
}
Series series_of(const std::vector<std::vector<double>>& rounds) {
  Series series;
  for (const auto& round : rounds) series.rounds.push_back(round_of(round));
  return series;
}

TEST(Series, IsComparedWithinEachRound) {
  // The second round is slow for both, the third for one alone.
  const Series one = series_of({{2, 4, 6}, {40, 40, 40}, {9, 9, 9}});
  const Series other = series_of({{2, 2, 2}, {20, 10, 30}, {1, 1, 1}});
  EXPECT_THAT(one.ratios_to(other), ElementsAre(2, 2, 9));
  EXPECT_DOUBLE_EQ(one.ratio_to(other), 2);
  EXPECT_DOUBLE_EQ(one.publish_ratio_to(other), 2);
  EXPECT_DOUBLE_EQ(one.ratio_to(one), 1);
}

TEST(Series, ThatHasARoundOfNoTimeLeavesItOut) {
  const Series one = series_of({{3}, {8}, {5}}), other = series_of({{0}, {2}});
  EXPECT_THAT(one.ratios_to(other), ElementsAre(4));
}

TEST(Series, HasTheMedianOfMediansAndTheTailOfAll) {
  const Series one = series_of({{1, 2, 3}, {10, 20, 30}, {4, 5, 6}});
  EXPECT_DOUBLE_EQ(one.p50_ns(), 5);
  EXPECT_DOUBLE_EQ(one.publish_p50_ns(), 0.5);
  EXPECT_THAT(one.latencies_ns(), ElementsAre(1, 2, 3, 10, 20, 30, 4, 5, 6));
  EXPECT_DOUBLE_EQ(one.p99_ns(), 20 + 0.92 * 10);
}

TEST(Series, CountsTheSlowestReceiverOfEachMessage) {
  Series one;
  one.rounds.push_back({.publish_ns = {1, 1}, .latency_ns = {{5, 9}, {7, 2}}});
  EXPECT_THAT(one.latencies_ns(), ElementsAre(7, 9));
  EXPECT_DOUBLE_EQ(one.p50_ns(), 8);
}

TEST(Series, OfEqualTailsHasAnIntervalThatIsAPoint) {
  const Series one = series_of({{3, 3}, {3, 3}}), other = series_of({{6, 6}, {6, 6}});
  EXPECT_DOUBLE_EQ(one.p99_ratio_to(other), 0.5);
  EXPECT_DOUBLE_EQ(one.p99_ratio_interval(other).low, 0.5);
  EXPECT_DOUBLE_EQ(one.p99_ratio_interval(other).high, 0.5);
}

// --- aims

nlohmann::json judged(const Run& run, std::optional<double> measured, Aims::Sense sense,
                      std::optional<Interval> interval = {}) {
  Report report(nullptr);
  report.is_quiet = true;
  Aims aims(run);
  aims.add("to be one", measured, sense, 1, interval);
  aims.tell(report);
  return report.results.at(0);
}
constexpr auto at_most = Aims::Sense::at_most, at_least = Aims::Sense::at_least;

TEST(Aims, AreReachedUpToTheirBound) {
  EXPECT_EQ(judged({}, 0.9, at_most).at("is_reached"), true);
  EXPECT_EQ(judged({}, 1.0, at_most).at("is_reached"), true);
  EXPECT_EQ(judged({}, 1.1, at_most).at("is_reached"), false);
  EXPECT_EQ(judged({}, 0.9, at_least).at("is_reached"), false);
  EXPECT_EQ(judged({}, 1.0, at_least).at("is_reached"), true);
}

TEST(Aims, WithAnIntervalAreReachedWhenAllOfItIs) {
  EXPECT_EQ(judged({}, 0.9, at_most, Interval{0.8, 0.99}).at("is_reached"), true);
  EXPECT_EQ(judged({}, 1.2, at_most, Interval{1.01, 1.3}).at("is_reached"), false);
  EXPECT_EQ(judged({}, 1.2, at_least, Interval{1.01, 1.3}).at("is_reached"), true);
  EXPECT_EQ(judged({}, 0.9, at_least, Interval{0.8, 0.99}).at("is_reached"), false);
  for (const auto sense : {at_most, at_least}) {
    const nlohmann::json undecided = judged({}, 0.9, sense, Interval{0.8, 1.1});
    EXPECT_FALSE(undecided.contains("is_reached"));
    EXPECT_THAT(undecided.at("not_judged").get<std::string>(), testing::HasSubstr("undecided"));
    EXPECT_EQ(undecided.at("measured_low"), 0.8);
    EXPECT_EQ(undecided.at("measured_high"), 1.1);
  }
}

TEST(Aims, AreNotJudgedByAShortRunOrByNone) {
  bench::Run small, few;
  small.is_small = true;
  few.rounds = bench::Run::enough_rounds - 1;
  for (const bench::Run& run : {small, few}) {
    const nlohmann::json result = judged(run, 0.5, at_most, Interval{0.4, 0.6});
    EXPECT_FALSE(result.contains("is_reached"));
    EXPECT_EQ(result.at("not_judged"), "not judged, too short a run");
    EXPECT_EQ(result.at("measured"), 0.5);
  }
  const nlohmann::json none = judged({}, {}, at_most);
  EXPECT_FALSE(none.contains("is_reached") || none.contains("measured"));
  EXPECT_EQ(none.at("not_judged"), "not measured");
}

}  // namespace
}  // namespace agnocast::bench
