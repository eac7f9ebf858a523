// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process that uses the library may be killed at any crash point: it disturbs no other
// process, its committed messages arrive, and nothing of it remains. Method: scripts steer the
// real library (with heap hook and control thread) against the real daemon. V is the victim; A and
// B survive. Each script runs once without a death; then V is killed at its 1st, 2nd, … n-th crash
// point until it survives. After each death:
//   - the daemon has recovered, and verify() holds with A and B in the middle of their work;
//   - A and B continue with the script, and get what they got without the death, except what V
//     had not committed (Performance::judge has the exact rule);
//   - when they are done, the daemon knows nothing that it did not know before;
//   - the whole script without a death gives every answer again, in the same places: table
//     indexes, extents, addresses of windows.
// In scripts that lose the daemon's store only a sample is tried, as each point starts two
// daemons; AGNOCAST_SEED chooses another sample, AGNOCAST_SWEEP=all tries all points. Without a
// death: processes and daemon are delayed at random points, and no process notices.
// AGNOCAST_ROTATION: a part of the points (tests/support/rotation.hpp), but every named one, and of
// the runs with delays.
// AGNOCAST_SWEEP_JITTER=N: surviving processes are delayed as well, at N of a million points.
// AGNOCAST_SWEEP_STRIDE=N tries every N-th point only, AGNOCAST_SWEEP_SCRIPT=I only script I.

#include <tests/recovery/sweep_script.hpp>
#include <tests/recovery/sweep_scripts.hpp>
#include <tests/support/rotation.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::sweep {
namespace {

struct Totals {
  std::uint64_t points = 0, deaths = 0, survived = 0;
  std::map<Step, std::uint64_t> died_at;  // how often
  std::vector<std::string> violations;
};

constexpr unsigned worker_count = 2;
// Points tried by default in a script that loses the store.
constexpr std::uint64_t tried_of_a_loss = 100;

/// Kills at every stride-th point; each worker takes a share of them.
Totals sweep(const Script& script, SweepStage& stage, unsigned worker, std::uint64_t stride) {
  Totals totals;
  Performance performance(stage, script);
  std::string wrong = performance.rehearse();
  if (script.loses_store() && !runs_everything())
    stride *= 1 + performance.points() / tried_of_a_loss;
  const std::uint64_t seed = number_of("AGNOCAST_SEED", test::Rotation().part()),
                      first = 1 + seed % stride, jitter = number_of("AGNOCAST_SWEEP_JITTER", 0);
  for (std::uint64_t n = first + worker * stride; wrong.empty(); n += worker_count * stride) {
    if (jitter != 0) performance.slow_down(1 + 10 * (seed + n), jitter);
    const Performance::Ended ended = performance.perform(n);
    totals.points = performance.points();
    if (!ended.wrong.empty()) {
      wrong = "death at point " + std::to_string(n) +
              (ended.died_at ? std::string(" (") + name_of(*ended.died_at) + ")" : "") + ": " +
              ended.wrong;
    } else if (ended.died_at) {
      ++totals.deaths;
      ++totals.died_at[*ended.died_at];
    } else if (n > performance.points()) {
      break;
    } else {
      ++totals.survived;  // the control thread looked less often than in the rehearsal
    }
  }
  if (!wrong.empty()) totals.violations.push_back(std::string(script.name) + ": " + wrong);
  return totals;
}

/// Returns the names with few deaths: the next run may miss them.
std::string rarest_of(const std::map<Step, std::uint64_t>& died_at) {
  constexpr std::uint64_t few = 5;
  std::string text;
  for (const auto& [step, deaths] : died_at) {
    if (deaths < few) text += std::string(" ") + name_of(step) + " " + std::to_string(deaths);
  }
  return text;
}

/// A point is not the same place in each run, so a run may miss a name that is reachable. Kills at
/// these names; names without a death even so stay in `left`.
void sweep_names(std::set<Step>& left, Totals& sum) {
  // The last script reaches names that others do not.
  for (std::size_t i = std::size(scripts); i-- > 0 && !left.empty();) {
    SweepStage stage;
    Performance performance(stage, scripts[i]);
    ASSERT_EQ(performance.rehearse(), "") << scripts[i].name;
    for (auto step = left.begin(); step != left.end();) {
      const Performance::Ended ended = performance.perform_from(*step);
      ASSERT_EQ(ended.wrong, "") << scripts[i].name << ": death at " << name_of(*step)
                                 << "\nagnocastd wrote:\n"
                                 << stage.daemon().log();
      sum.deaths += ended.died_at ? 1u : 0u;
      step = ended.died_at ? left.erase(step) : std::next(step);
    }
  }
}

TEST(ClientSweep, AProcessKilledAtAnyPointDisturbsNoOtherAndLeavesNothing) {
  const test::Rotation rotation;
  const std::uint64_t given = number_of("AGNOCAST_SWEEP_STRIDE", 0),
                      stride = given != 0 ? given : rotation.parts();
  const std::uint64_t only = number_of("AGNOCAST_SWEEP_SCRIPT", 0);
  Totals sum, losses;
  for (std::size_t i = 0; i < std::size(scripts); ++i) {
    if (only != 0 && only != i + 1) continue;
    const auto begin = std::chrono::steady_clock::now();
    // Made in this thread: a daemon dies with the thread that started it.
    std::vector<std::unique_ptr<SweepStage>> stages;
    std::vector<Totals> parts(worker_count);
    for (unsigned w = 0; w < worker_count; ++w) stages.push_back(std::make_unique<SweepStage>());
    std::vector<std::thread> workers;
    for (unsigned w = 0; w < worker_count; ++w) {
      workers.emplace_back([&, w] { parts[w] = sweep(scripts[i], *stages[w], w, stride); });
    }
    for (std::thread& worker : workers) worker.join();
    Totals total;
    for (unsigned w = 0; w < worker_count; ++w) {
      total.points = std::max(total.points, parts[w].points);
      total.deaths += parts[w].deaths;
      total.survived += parts[w].survived;
      for (const auto& [step, deaths] : parts[w].died_at) total.died_at[step] += deaths;
      for (const std::string& violation : parts[w].violations) {
        ADD_FAILURE() << violation << "\nagnocastd wrote:\n" << stages[w]->daemon().log();
        total.violations.push_back(violation);
      }
    }
    const double seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    std::printf("%-62s %4ju points, %4ju deaths at %2zu names, %2zu violations, %5.1f s\n",
                scripts[i].name, std::uintmax_t{total.points}, std::uintmax_t{total.deaths},
                total.died_at.size(), total.violations.size(), seconds);
    std::fflush(stdout);
    sum.points += total.points;
    if (scripts[i].loses_store()) {
      losses.points += total.points;
      losses.deaths += total.deaths;
    }
    sum.deaths += total.deaths;
    sum.survived += total.survived;
    for (const auto& [step, deaths] : total.died_at) sum.died_at[step] += deaths;
    sum.violations.insert(sum.violations.end(), total.violations.begin(), total.violations.end());
  }
  std::printf(
      "clients: %ju points (every %ju. of them tried), %ju deaths, %ju not reached again, "
      "%zu violations\n",
      std::uintmax_t{sum.points}, std::uintmax_t{stride}, std::uintmax_t{sum.deaths},
      std::uintmax_t{sum.survived}, sum.violations.size());
  std::printf("rotation: %s\n", rotation.text().c_str());
  std::printf("where the store is lost: %ju of the points, %ju of the deaths%s\n",
              std::uintmax_t{losses.points}, std::uintmax_t{losses.deaths},
              runs_everything() ? "" : " (a sample; AGNOCAST_SWEEP=all: every point)");
  std::set<Step> left;
  for (const NamedStep& named : client_steps) {
    if (sum.died_at.count(named.step) == 0) left.insert(named.step);
  }
  std::printf("fewest deaths at:%s\n", rarest_of(sum.died_at).c_str());
  if (given == 0 && only == 0 && sum.violations.empty()) sweep_names(left, sum);
  std::string missed;
  for (const Step step : left) missed += std::string(" ") + name_of(step);
  std::printf("nobody died at:%s\n", missed.empty() ? " (every C_ name was hit)" : missed.c_str());
  if (given == 0 && only == 0) {
    EXPECT_EQ(missed, "") << "a named crash point that no script reaches";
  }
}

// Each run interleaves concurrent operations differently.
TEST(ClientSweep, DelaysOfAnyProcessChangeNoResult) {
  constexpr std::uint64_t points_per_million = 50'000;
  const test::Rotation rotation;
  const std::uint64_t runs = runs_everything() ? 200 : 10,
                      only = number_of("AGNOCAST_SWEEP_SCRIPT", 0);
  for (std::size_t i = 0; i < std::size(scripts); ++i) {
    if (only != 0 && only != i + 1) continue;
    SweepStage stage;
    Performance performance(stage, scripts[i]);
    ASSERT_EQ(performance.rehearse(), "") << scripts[i].name;
    for (std::uint64_t run = 0; run < runs; ++run) {
      if (!rotation.takes(run, runs)) continue;
      const std::uint64_t seed = 1 + 10 * (number_of("AGNOCAST_SEED", 0) + run);
      ASSERT_EQ(performance.perform_slowly(seed, points_per_million), "")
          << scripts[i].name << ", run " << run << "\nagnocastd wrote:\n"
          << stage.daemon().log();
    }
  }
}

}  // namespace
}  // namespace agnocast::sweep
