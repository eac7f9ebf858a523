// SPDX-License-Identifier: Apache-2.0
//
// Goal: no interleaving of publish, take, release, sleep, join, leave, growth and deaths of any
// process breaks an invariant. Method: every plan is explored to the end on the shipped templates;
// the numbers of states are printed. AGNOCAST_ROTATION: a part of the large plans
// (tests/support/rotation.hpp).

#include <tests/model/plans.hpp>
#include <tests/support/rotation.hpp>

#include <gtest/gtest.h>

#include <cstdio>
#include <iterator>
#include <ostream>
#include <string>
#include <vector>

namespace agnocast::model {

void PrintTo(const QueuePlan& plan, std::ostream* out) { *out << plan.name; }

namespace {

// Twice the largest plan (13 M states, 80 MB of fingerprints): more means that somebody widened
// the scenario by mistake.
constexpr std::uint64_t state_limit = 20'000'000;

std::vector<QueuePlan> proof_plans_of_this_run() {
  const test::Rotation rotation;
  std::vector<QueuePlan> chosen;
  for (std::size_t i = 0; i < std::size(proof_plans); ++i)
    if (rotation.takes(i, std::size(proof_plans))) chosen.push_back(proof_plans[i]);
  std::printf("%zu large plans, %s\n", std::size(proof_plans), rotation.text().c_str());
  return chosen;
}

class QueueModel : public testing::TestWithParam<QueuePlan> {};

TEST_P(QueueModel, HasNoBadInterleaving) {
  machine.mutation = {};
  QueueScenario scenario(GetParam());
  Explorer<QueueScenario> explorer(scenario, state_limit);
  const Report report = explorer.explore(scenario.start());
  std::printf("%-62s %9llu states %10llu transitions %7llu endings\n", GetParam().name,
              static_cast<unsigned long long>(report.states),
              static_cast<unsigned long long>(report.transitions),
              static_cast<unsigned long long>(report.endings));
  std::string trace;
  for (const std::string& line : report.trace) trace += line + "\n";
  EXPECT_EQ(report.violation, "") << "after\n" << trace;
  EXPECT_TRUE(report.complete) << "the exploration reached the state limit";
  EXPECT_GT(report.endings, 0u) << "no run reached an end";
}

TEST(QueueModelFaults, NoticeRingsLostOrRepeatedBySharingANumber) {
  for (const FaultyPlan& faulty : faulty_plans) {
    QueuePlan plan = faulty.plan;
    plan.fault = faulty.fault;
    machine.mutation = faulty.mutation;
    QueueScenario scenario(plan);
    Explorer<QueueScenario> explorer(scenario, state_limit);
    const Report report = explorer.explore(scenario.start());
    machine.mutation = {};
    std::printf("noticed   %-52s %9llu states\n", faulty.name,
                static_cast<unsigned long long>(report.states));
    EXPECT_EQ(report.violation, faulty.violation) << faulty.name;
  }
}

INSTANTIATE_TEST_SUITE_P(Proof, QueueModel, testing::ValuesIn(proof_plans_of_this_run()));
INSTANTIATE_TEST_SUITE_P(Small, QueueModel, testing::ValuesIn(mutant_plans));

}  // namespace
}  // namespace agnocast::model
