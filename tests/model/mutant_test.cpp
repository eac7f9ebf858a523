// SPDX-License-Identifier: Apache-2.0
//
// Goal: the explorer would notice a missing statement or a wrong decision of the protocol, so its
// green runs mean something. Method: leave out each named statement and fence in turn, force each
// named decision to true and to false in turn, and demand a violation in one of the small plans. A
// mutant that survives must be listed below with the reason why it changes nothing.

#include <tests/model/plans.hpp>
#include <tests/model/reuse_scenario.hpp>
#include <tests/support/rotation.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <ostream>
#include <string>
#include <vector>

namespace agnocast::model {

void PrintTo(const Mutation& mutation, std::ostream* out) { *out << name_of(mutation.step); }

namespace {

struct Equivalent {
  Mutation mutation;
  const char* reason;
};

// Surviving mutants, each with the reason. A listed mutant that is noticed also fails the test:
// then the list is out of date.
const Equivalent equivalent[] = {
    {{steps::P7_changed, Mutation::Kind::force_true}, "reads the same words again"},
    {{steps::P7_seen, Mutation::Kind::leave_out},
     "since is too low: keeps more until the endpoint links, loses nothing"},
    {{steps::P10_past, Mutation::Kind::force_false},
     "no direct free: marked now, freed by a later scan"},
    {{steps::T2_order, Mutation::Kind::force_true}, "T3 and T5 compare the slot's own sequence"},
    {{steps::T3_live, Mutation::Kind::force_true}, "saves a pin only; T5 decides"},
    {{steps::J6_check, Mutation::Kind::force_true}, "rule RU guarantees it already"},
    {{steps::E2_clear, Mutation::Kind::force_false}, "looked at for ever: costs a look"},
    {{steps::S5_disarm, Mutation::Kind::leave_out},
     "somebody awake is rung once per generation: costs a system call"},
};

const char* reason_to_survive(const Mutation& mutation) {
  for (const Equivalent& entry : equivalent) {
    if (entry.mutation.step == mutation.step && entry.mutation.kind == mutation.kind)
      return entry.reason;
  }
  return nullptr;
}

const char* kind_name(Mutation::Kind kind) {
  switch (kind) {
    case Mutation::Kind::leave_out:
      return "left out";
    case Mutation::Kind::force_true:
      return "always true";
    case Mutation::Kind::force_false:
      return "always false";
    case Mutation::Kind::none:
      break;
  }
  return "unchanged";
}

// Running the code shows which steps are statements and which are decisions, so the test cannot
// miss one.
std::vector<Mutation> learn_mutants() {
  machine.mutation = {};
  machine.statements = {};
  machine.decisions = {};
  for (const QueuePlan& plan : mutant_plans) {
    QueueScenario scenario(plan);
    Explorer<QueueScenario> explorer(scenario, 3'000'000);
    explorer.explore(scenario.start());
  }
  std::vector<Mutation> mutants;
  for (const NamedStep& named : all_steps) {
    const Step step = named.step;
    if (machine.has_stated(step)) mutants.push_back({step, Mutation::Kind::leave_out});
    if (machine.has_decided(step)) {
      mutants.push_back({step, Mutation::Kind::force_true});
      mutants.push_back({step, Mutation::Kind::force_false});
    }
  }
  return mutants;
}

// States of each plan, in turn: some plan notices most mutants early. An equivalent mutant would
// be explored to the end of every plan; that no plan notices it early is enough for the list.
std::vector<std::uint64_t> limits_for(const Mutation& mutation) {
  if (reason_to_survive(mutation) != nullptr) return {300'000};
  return {30'000, 6'000'000};
}

TEST(ModelMutants, EveryStatementFenceAndDecisionOfTheProtocolIsNeeded) {
  const std::vector<Mutation> mutants = learn_mutants();
  ReuseScenario reuse({.name = "rule RU"});  // its mutants are in reuse_model_test.cpp
  Explorer<ReuseScenario>(reuse, 1'000'000).explore(reuse.start());
  for (const NamedStep& named : all_steps) {
    const Step step = named.step;
    const char kind = named.name[0];
    // The redo log and the control plane: the crash sweeps kill at each of their steps.
    if (kind == 'W' || kind == 'B' || kind == 'C') continue;
    const bool reached =
        kind == 'R' ? machine.has_stated(step) || machine.has_decided(step)
                    : std::any_of(mutants.begin(), mutants.end(),
                                  [&](const Mutation& mutant) { return mutant.step == step; });
    EXPECT_TRUE(reached) << named.name << " is never reached";
  }
  // Plans that noticed one mutant often notice the next: they come first.
  std::vector<const QueuePlan*> plans;
  for (const QueuePlan& plan : mutant_plans) plans.push_back(&plan);
  unsigned killed = 0;
  unsigned survived = 0;
  const test::Rotation rotation;
  for (std::size_t i = 0; i < mutants.size(); ++i) {
    if (!rotation.takes(i, mutants.size())) continue;
    const Mutation& mutation = mutants[i];
    std::string noticed;
    const char* plan_name = "";
    for (const std::uint64_t state_limit : limits_for(mutation)) {
      for (auto plan = plans.begin(); plan != plans.end() && noticed.empty(); ++plan) {
        machine.mutation = mutation;
        QueueScenario scenario(**plan);
        Explorer<QueueScenario> explorer(scenario, state_limit);
        noticed = explorer.explore(scenario.start()).violation;
        plan_name = (*plan)->name;
        if (!noticed.empty()) {
          std::rotate(plans.begin(), plan, plan + 1);
          break;
        }
      }
    }
    machine.mutation = {};
    const char* reason = reason_to_survive(mutation);
    if (!noticed.empty()) {
      ++killed;
      std::printf("noticed   %-16s %-12s %-55s [%s]\n", name_of(mutation.step),
                  kind_name(mutation.kind), noticed.c_str(), plan_name);
      EXPECT_EQ(reason, nullptr) << name_of(mutation.step)
                                 << " is listed as equivalent but was noticed: " << noticed;
    } else {
      ++survived;
      std::printf("survives  %-16s %-12s %s\n", name_of(mutation.step), kind_name(mutation.kind),
                  reason != nullptr ? reason : "UNEXPLAINED");
      EXPECT_NE(reason, nullptr) << name_of(mutation.step) << " " << kind_name(mutation.kind)
                                 << " changes nothing that the plans check";
    }
    std::fflush(stdout);
  }
  std::printf("%zu mutants, %s: %u noticed, %u equivalent\n", mutants.size(),
              rotation.text().c_str(), killed, survived);
}

}  // namespace
}  // namespace agnocast::model
