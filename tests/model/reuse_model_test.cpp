// SPDX-License-Identifier: Apache-2.0
//
// Goal: memory is never reused while another process may still look at it, and never lost (rule
// RU). Method: explore the handshake with deaths of all processes on the shipped sets; then leave
// out each of its statements in turn.

#include <tests/model/reuse_scenario.hpp>

#include <gtest/gtest.h>

#include <cstdio>
#include <string>

namespace agnocast::model {
namespace {

constexpr ReusePlan plans[] = {
    {.name = "3 generations, subscriber dies once, daemon twice"},
    {.name = "4 generations, subscriber dies twice, daemon three times",
     .generations = 4,
     .daemon_deaths = 3,
     .subscriber_lives = 3},
    {.name = "4 generations, connection lost three times, daemon dies once",
     .generations = 4,
     .daemon_deaths = 1,
     .subscriber_lives = 1,
     .disconnections = 3},
    {.name = "3 generations, connection lost twice, everybody dies once",
     .daemon_deaths = 1,
     .disconnections = 2},
};

Report explore(const ReusePlan& plan) {
  ReuseScenario scenario(plan);
  Explorer<ReuseScenario> explorer(scenario, 20'000'000);
  return explorer.explore(scenario.start());
}

TEST(ReuseModel, HasNoBadInterleaving) {
  machine.mutation = {};
  for (const ReusePlan& plan : plans) {
    const Report report = explore(plan);
    std::printf("%-60s %9llu states %7llu endings\n", plan.name,
                static_cast<unsigned long long>(report.states),
                static_cast<unsigned long long>(report.endings));
    std::string trace;
    for (const std::string& line : report.trace) trace += line + "\n";
    EXPECT_EQ(report.violation, "") << "after\n" << trace;
    EXPECT_TRUE(report.complete);
    EXPECT_GT(report.endings, 0u);
  }
}

TEST(ReuseModel, NoticesAPublisherThatStartsOnTheLineOfAnOlderOne) {
  machine.mutation = {};
  ReusePlan plan = plans[0];
  plan.says_unlinked_first = true;
  EXPECT_EQ(explore(plan).violation, "a publisher begins on the line of an older one");
}

class ReuseMutants : public testing::TestWithParam<Mutation> {};

TEST_P(ReuseMutants, AreNoticed) {
  machine.mutation = GetParam();
  const Report report = explore(plans[1]);
  machine.mutation = {};
  std::printf("noticed   %-16s %s\n", name_of(GetParam().step), report.violation.c_str());
  EXPECT_NE(report.violation, "") << name_of(GetParam().step);
}

using Kind = Mutation::Kind;
INSTANTIATE_TEST_SUITE_P(Each, ReuseMutants,
                         testing::Values(Mutation{steps::R1_tell, Kind::leave_out},
                                         Mutation{steps::R2_unmapped, Kind::leave_out},
                                         Mutation{steps::R2_generation, Kind::force_true},
                                         Mutation{steps::R2_generation, Kind::force_false},
                                         Mutation{steps::R3_died, Kind::leave_out},
                                         Mutation{steps::R4_reusable, Kind::force_true},
                                         Mutation{steps::R4_reusable, Kind::force_false},
                                         Mutation{steps::R5_again, Kind::force_true},
                                         Mutation{steps::R5_again, Kind::force_false},
                                         Mutation{steps::R6_link, Kind::leave_out},
                                         Mutation{steps::R7_unlinked, Kind::leave_out},
                                         Mutation{steps::R8_again, Kind::leave_out},
                                         Mutation{steps::J6_generation, Kind::leave_out},
                                         Mutation{steps::L1_release, Kind::leave_out},
                                         Mutation{steps::U1_generation, Kind::leave_out},
                                         Mutation{steps::U2_cursor, Kind::leave_out}),
                         [](const auto& mutant) {
                           return std::string(name_of(mutant.param.step)) + "_" +
                                  std::to_string(static_cast<int>(mutant.param.kind));
                         });

}  // namespace
}  // namespace agnocast::model
