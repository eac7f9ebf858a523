// SPDX-License-Identifier: Apache-2.0
//
// Goal: systems are compared within a round, and an aim is judged only where the data allow it.
// Method: rounds whose figures are known by hand.

#include <bench/comparison.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>
#include <vector>

namespace agnocast::bench {
namespace {

using testing::ElementsAre;

/// One receiver, and publish calls that take a tenth of its latency.
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
  // The second round is slow for both, the third for only one.
  const Series one = series_of({{2, 4, 6}, {40, 40, 40}, {9, 9, 9}});
  const Series other = series_of({{2, 2, 2}, {20, 10, 30}, {1, 1, 1}});
  EXPECT_THAT(one.ratios_to(other), ElementsAre(2, 2, 9));
  EXPECT_DOUBLE_EQ(one.ratio_to(other), 2);
  EXPECT_DOUBLE_EQ(one.publish_ratio_to(other), 2);
  EXPECT_DOUBLE_EQ(one.ratio_to(one), 1);
  EXPECT_THAT(one.differences_to(other), ElementsAre(2, 20, 8));
}

TEST(Series, LeavesOutARoundWithoutTime) {
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

TEST(Series, TakesEightPublishCallsTogether) {
  Series one;
  one.rounds.push_back({.publish_ns = {}, .latency_ns = {{}}, .sender_cpu_ns = 6});
  // Three periods of one expensive and seven cheap calls, the last disturbed, and a remainder.
  for (const double last : {1.0, 1.0, 1000.0}) {
    one.rounds[0].publish_ns.insert(one.rounds[0].publish_ns.end(), {9, 1, 1, 1, 1, 1, 1, last});
  }
  one.rounds[0].publish_ns.insert(one.rounds[0].publish_ns.end(), {500, 500});
  EXPECT_DOUBLE_EQ(one.publish_of_eight_ns(), 2);
  EXPECT_DOUBLE_EQ(one.publish_p50_ns(), 1);
  Series half = one;
  half.rounds[0].sender_cpu_ns = 3;
  EXPECT_THAT(one.sender_cpu_ratios_to(half), ElementsAre(2));
}

TEST(Series, CountsTheSlowestReceiverOfEachMessage) {
  Series one;
  one.rounds.push_back({.publish_ns = {1, 1}, .latency_ns = {{5, 9}, {7, 2}}});
  EXPECT_THAT(one.latencies_ns(), ElementsAre(7, 9));
  EXPECT_DOUBLE_EQ(one.p50_ns(), 8);
}

TEST(Series, WithEqualTailsHasAPointAsInterval) {
  const Series one = series_of({{3, 3}, {3, 3}}), other = series_of({{6, 6}, {6, 6}});
  EXPECT_DOUBLE_EQ(one.p99_ratio_to(other), 0.5);
  EXPECT_DOUBLE_EQ(one.p99_ratio_interval(other).low, 0.5);
  EXPECT_DOUBLE_EQ(one.p99_ratio_interval(other).high, 0.5);
}

TEST(Turn, ThatFailsIsSkippedOnlyForAPeerSystem) {
  System peer{}, ours{};
  peer.name = "iceoryx-listener";
  ours.name = "agnocast-take";
  const auto fails = [] { throw std::runtime_error("lost"); };
  EXPECT_TRUE(takes_its_turn(peer, [] {}));
  EXPECT_FALSE(takes_its_turn(peer, fails));
  EXPECT_THROW(takes_its_turn(ours, fails), std::runtime_error);
}

// --- aims

/// Tests must not depend on how this program was built.
bench::Run of_a_build_to_measure(bench::Run run = {}) {
  run.has_assertions = false;
  return run;
}

nlohmann::json judged(const bench::Run& run, std::optional<double> measured, Aims::Sense sense,
                      std::optional<Interval> interval = {}, const Basis& basis = {}) {
  Report report(nullptr);
  report.is_quiet = true;
  Aims aims(of_a_build_to_measure(run));
  aims.add("to be one", measured, sense, 1, interval, basis);
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

TEST(Aims, WithAnIntervalAreReachedWhenAllOfItReachesThem) {
  EXPECT_EQ(judged({}, 0.9, at_most, Interval{0.8, 0.99}).at("is_reached"), true);
  EXPECT_EQ(judged({}, 1.2, at_most, Interval{1.01, 1.3}).at("is_reached"), false);
  EXPECT_EQ(judged({}, 1.2, at_least, Interval{1.01, 1.3}).at("is_reached"), true);
  EXPECT_EQ(judged({}, 0.9, at_least, Interval{0.8, 0.99}).at("is_reached"), false);
  EXPECT_EQ(judged({}, 0.9, at_most, Interval{0.8, 1}).at("is_reached"), true);
  for (const auto sense : {at_most, at_least}) {
    const nlohmann::json undecided = judged({}, 0.9, sense, Interval{0.8, 1.1});
    EXPECT_FALSE(undecided.contains("is_reached"));
    EXPECT_THAT(undecided.at("not_judged").get<std::string>(), testing::HasSubstr("undecided"));
    EXPECT_EQ(undecided.at("measured_low"), 0.8);
    EXPECT_EQ(undecided.at("measured_high"), 1.1);
  }
}

TEST(Aims, AreNotJudgedByAShortRunOrWithoutOne) {
  bench::Run small, few;
  small.is_small = true;
  few.rounds = bench::Run::enough_rounds - 1;
  for (const bench::Run& run : {small, few}) {
    const nlohmann::json result = judged(run, 0.5, at_most, Interval{0.4, 0.6});
    EXPECT_FALSE(result.contains("is_reached"));
    EXPECT_EQ(result.at("not_judged"), "not judged, too short a run");
    EXPECT_EQ(result.at("measured"), 0.5);
  }
  const Basis few_messages{.messages = Basis::enough_for_p50 - 1};
  EXPECT_EQ(judged({}, 0.5, at_most, {}, few_messages).at("not_judged"),
            "not judged, too short a run");
  EXPECT_EQ(judged(few, 0.5, at_most, {}, {.is_of_rounds = false}).at("is_reached"), true);
  const nlohmann::json none = judged({}, {}, at_most);
  EXPECT_FALSE(none.contains("is_reached") || none.contains("measured"));
  EXPECT_EQ(none.at("not_judged"), "not measured");
}

TEST(Aims, AreNotJudgedWhereTimesAreUnreliable) {
  EXPECT_EQ(judged({}, 0.5, at_most, {}, {.is_without_fifo = true}).at("not_judged"),
            "not judged, SCHED_FIFO was refused");
  Report report(nullptr);
  report.is_quiet = true;
  bench::Run run;
  run.has_assertions = true;
  Aims aims(run);
  aims.add("to be one", 0.5, at_most, 1);
  aims.tell(report);
  EXPECT_EQ(report.results.at(0).at("not_judged"), "not judged, a build with assertions");
}

TEST(Aims, OverRoundsAreJudgedByTheIntervalOfTheirMedian) {
  Report report(nullptr);
  report.is_quiet = true;
  Aims aims(of_a_build_to_measure());
  aims.add_median("all below", {0.7, 0.2, 0.3, 0.4, 0.5, 0.6, 0.1}, at_most, 0.7);
  aims.add_median("one above", {0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8}, at_most, 0.7);
  aims.add_median("none", {}, at_most, 0.7);
  aims.add_information("beside", {3, 1, 2});
  aims.tell(report);
  EXPECT_EQ(report.results.at(0).at("measured"), 0.4);
  EXPECT_EQ(report.results.at(0).at("is_reached"), true);
  EXPECT_THAT(report.results.at(1).at("not_judged").get<std::string>(),
              testing::HasSubstr("undecided"));
  EXPECT_EQ(report.results.at(2).at("not_judged"), "not measured");
  EXPECT_EQ(report.results.at(3).at("beside_aims"), "beside");
  EXPECT_EQ(report.results.at(3).at("measured"), 2);
  EXPECT_FALSE(report.results.at(3).contains("bound"));
}

TEST(Aims, RestOnAllSystemsThatTookPart) {
  Comparison comparison{.plan = {.messages = 70, .cores = Cores::one},
                        .series = {series_of({{1}}), series_of({{2}})}};
  EXPECT_FALSE(basis_of(comparison).is_without_fifo);
  EXPECT_EQ(basis_of(comparison).messages, 70u);
  comparison.series[1].rounds[0].is_without_fifo = true;
  EXPECT_TRUE(basis_of(comparison).is_without_fifo);
  comparison.plan.cores = Cores::two;
  EXPECT_FALSE(basis_of(comparison).is_without_fifo);
}

}  // namespace
}  // namespace agnocast::bench
