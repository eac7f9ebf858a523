// SPDX-License-Identifier: Apache-2.0
//
// Goal: no message waits while all threads that could run its callback sleep, whatever groups are
// busy meanwhile and however groups move between cores. Method: explore the scenarios; then leave
// out each of their statements in turn.

#include <tests/model/executor_scenario.hpp>
#include <tests/model/isolation_scenario.hpp>

#include <gtest/gtest.h>

#include <cstdio>
#include <string>

namespace agnocast::model {
namespace {

constexpr ExecutorPlan one_executor = {.name = "two threads, two groups", .messages = 3};
constexpr ExecutorPlan stopping = {
    .name = "three threads, two groups, one thread stops", .threads = 3, .first_stops = true};
constexpr ExecutorPlan blocked = {.name = "three threads, three groups, one callback never ends",
                                  .threads = 3,
                                  .groups = 3,
                                  .first_never_ends = true};
constexpr ExecutorPlan shared = {.name = "two executors, two threads and one, one wait set",
                                 .threads = 3,
                                 .core_of_thread = {0, 0, 1},
                                 .groups = 3,
                                 .core_of_group = {0, 0, 1},
                                 .messages = 1};

Report explore(const ExecutorPlan& plan) {
  ExecutorScenario scenario(plan);
  Explorer<ExecutorScenario> explorer(scenario, 20'000'000);
  return explorer.explore(scenario.start());
}

std::string trace_of(const Report& report) {
  std::string trace;
  for (const std::string& line : report.trace) trace += line + "\n";
  return trace;
}

TEST(ExecutorModel, HasNoBadInterleaving) {
  ExecutorPlan four = one_executor;
  four.name = "four threads, two groups";
  four.threads = 4;
  four.messages = 2;
  for (const ExecutorPlan& plan : {one_executor, stopping, blocked, shared, four}) {
    const Report report = explore(plan);
    std::printf("%-60s %9llu states %7llu endings\n", plan.name,
                static_cast<unsigned long long>(report.states),
                static_cast<unsigned long long>(report.endings));
    EXPECT_EQ(report.violation, "") << "after\n" << trace_of(report);
    EXPECT_TRUE(report.complete);
    EXPECT_GT(report.endings, 0u);
  }
}

TEST(ExecutorModel, NoticesEachStatementThatIsLeftOut) {
  const auto violation = [](ExecutorPlan plan, ExecutorFault fault) {
    plan.fault = fault;
    return explore(plan).violation;
  };
  const std::string waits = "a message waits while all threads sleep";
  EXPECT_EQ(violation(blocked, ExecutorFault::nobody_takes_over), waits);
  EXPECT_EQ(violation(stopping, ExecutorFault::stops_silently), waits);
  EXPECT_EQ(violation(shared, ExecutorFault::same_value_armed), waits);
  EXPECT_EQ(violation(shared, ExecutorFault::first_disarms_for_all), waits);
  EXPECT_EQ(violation(one_executor, ExecutorFault::waits_after_nothing), waits);
}

constexpr IsolationPlan creating = {.name = "an endpoint is created while its group is isolated"};
constexpr IsolationPlan repeating = {.name = "the same, and listening fails once",
                                     .first_listening_fails = true};

Report explore(const IsolationPlan& plan) {
  IsolationScenario scenario(plan);
  Explorer<IsolationScenario> explorer(scenario, 1'000'000);
  return explorer.explore(scenario.start());
}

TEST(IsolationModel, HasNoBadInterleaving) {
  for (const IsolationPlan& plan : {creating, repeating}) {
    const Report report = explore(plan);
    std::printf("%-60s %9llu states %7llu endings\n", plan.name,
                static_cast<unsigned long long>(report.states),
                static_cast<unsigned long long>(report.endings));
    EXPECT_EQ(report.violation, "") << "after\n" << trace_of(report);
    EXPECT_TRUE(report.complete);
    EXPECT_GT(report.endings, 0u);
  }
}

TEST(IsolationModel, NoticesEachStatementThatIsLeftOut) {
  const auto violation = [](IsolationPlan plan, IsolationFault fault) {
    plan.fault = fault;
    return explore(plan).violation;
  };
  const std::string waits = "a message waits while the group's thread sleeps";
  EXPECT_EQ(violation(creating, IsolationFault::listens_first), waits);
  EXPECT_EQ(violation(creating, IsolationFault::adopts_deaf), waits);
  EXPECT_EQ(violation(creating, IsolationFault::listens_silently), waits);
  EXPECT_EQ(violation(repeating, IsolationFault::keeps_former), waits);
}

}  // namespace
}  // namespace agnocast::model
