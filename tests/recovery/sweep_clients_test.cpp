// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process that uses the library may be killed at any crash point of anything it does: it
// disturbs nobody, what it had committed arrives, and nothing of it stays behind.
// Method: scripts steer the real library (with heap hook and control thread) against the real daemon.
// V is the victim, A and B survive. Each script runs once without a death; then V is killed at its
// 1st, 2nd, … n-th crash point until it survives. After each death:
//   - the daemon has recovered, and verify() holds with the survivors in the middle of their work;
//   - the survivors go on with the script, and get what they got without the death, except what V
//     had not committed (Judge says it exactly);
//   - when they are through, the daemon knows nothing that it did not know before;
//   - the whole script without a death gives every answer again, in the same places: table
//     indexes, extents, addresses of windows.
// AGNOCAST_SWEEP_STRIDE=N tries every N-th point only, AGNOCAST_SWEEP_SCRIPT=I the I-th script only.

#include <tests/recovery/sweep_script.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::sweep {
namespace {

const Script scripts[] = {
    {"a publisher's life",
     "A sub 1 /s 20; sync; V pub 2 /s 20; sync; V publish 2 1; V publish 2 1; A take 1; V publish "
     "2 1;"
     "A take 1; A release; V publish 2 1; V unpub 2; V sync; A drain 1; A release; V sync; V quit;"
     "A drain 1; A unsub 1"},
    {"a subscription's life",
     "A pub 1 /s 20; sync; V sub 2 /s 20; sync; A publish 1 3; V take 2; V take 2; V release;"
     "A publish 1 1; V take 2; V unsub 2; V sync; V release; V release; V sync; A publish 1 1; V "
     "quit;"
     "A publish 1 1; A unpub 1"},
    {"a publisher that exits at once",
     "A sub 1 /s 20; sync; V pub 2 /s 20; V publish 2 1; V publish 2 1; V publish 2 1; V quit;"
     "A drain 1; A unsub 1"},
    {"history for a late joiner",
     "V pub 2 /s 5t; V publish 2 1; V publish 2 1; V publish 2 1; A sub 1 /s 5t; sync; V publish 2 "
     "1;"
     "A take 1; A drain 1; V unpub 2; V sync; V quit; A release; A drain 1; A unsub 1"},
    {"one of two publishers",
     "A sub 1 /s 40; B sub 4 /s 40; B pub 3 /s 40; V pub 2 /s 40; sync; B publish 3 2; V publish 2 "
     "1;"
     "B publish 3 1; A take 1; V publish 2 1; B drain 4; V unpub 2; V sync; B publish 3 1; V quit;"
     "A release; A drain 1; B drain 4; B unpub 3; sync; A unsub 1; B unsub 4"},
    {"one of two subscribers",
     "A pub 1 /s 40; B sub 4 /s 40; V sub 2 /s 40; sync; A publish 1 2; V take 2; B take 4;"
     "A publish 1 2; V drain 2; V release; B drain 4; V quit; A publish 1 1; B drain 4; B release;"
     "A unpub 1; sync; B unsub 4"},
    {"a process that publishes to itself and to another",
     "V sub 2 /s 20; V pub 3 /s 20; A sub 1 /s 20; sync; V publish 3 1; V take 2; V publish 3 1;"
     "A take 1; V drain 2; V release; V unsub 2; V publish 3 1; V unpub 3; V sync; V quit; A "
     "release;"
     "A drain 1; A unsub 1"},
    {"callbacks that sleep and are rung",
     "V cb 2 /s 20; V cb 5 /t 20; V pub 3 /u 20; A cb 1 /u 20; A pub 4 /s 20; sync; A publish 4 1;"
     "V sync; A publish 4 1; V publish 3 1; A sync; V publish 3 1; V unsub 5; V unsub 2; V unpub 3;"
     "V sync; V quit; A heard 1; A unsub 1; A unpub 4"},
    {"more sleepers than publish rings by itself",
     "V cb 2 /s 20; A cb 1 /s 20; B cb 4 /s 20; V pub 3 /s 20; sync; V publish 3 1; A sync; V "
     "publish 3 1;"
     "V unsub 2; V publish 3 1; V unpub 3; V sync; V quit; A heard 1; B heard 4; A unsub 1; B "
     "unsub 4"},
    {"adoption",
     "A sub 1 /s 20; sync; V pub 2 /s 20; sync; V foreign 2 1; V publish 2 1; A take 1; V foreign "
     "2 1;"
     "A drain 1; A release; V sync; V publish 2 1; V unpub 2; V sync; V quit; A drain 1; A unsub "
     "1"},
    {"keep-all and a reader that is behind",
     "A sub 1 /s 2a; sync; V pub 2 /s 2a; sync; V publish 2 1; V publish 2 1; V publish 2 1; A "
     "take 1;"
     "V publish 2 1; A drain 1; V publish 2 1; A release; V unpub 2; V sync; V quit; A drain 1;"
     "A unsub 1"},
    {"joins and leaves again and again",
     "A sub 1 /s 20; A pub 4 /t 20; sync; V pub 2 /s 20; V sub 3 /t 20; sync; V publish 2 1;"
     "A publish 4 1; V take 3; V unpub 2; V unsub 3; V sync; A drain 1; V pub 5 /s 20; V sub 6 /t "
     "20;"
     "sync; V publish 5 1; A publish 4 1; V drain 6; V release; A drain 1; V unpub 5; V unsub 6; V "
     "sync;"
     "V quit; A drain 1; A unsub 1; A unpub 4"},
    {"a publisher that dies while others hold, and its forked child",
     "A sub 1 /s 20; B sub 4 /s 20; sync; V pub 2 /s 20; sync; V publish 2 1; V publish 2 1; A "
     "take 1;"
     "B take 4; V fork; V publish 2 1; V unpub 2; V sync; A release; V sync; V quit; B release;"
     "A drain 1; B drain 4; A unsub 1; B unsub 4"},
    {"a subscriber of a publisher that leaves",
     "A pub 1 /s 20; sync; V sub 2 /s 20; sync; A publish 1 3; V take 2; A unpub 1; A sync; V "
     "drain 2;"
     "V release; V sync; A pub 3 /s 20; sync; A publish 3 1; V drain 2; V unsub 2; V sync; V quit;"
     "A unpub 3"},
    {"a publisher whose subscribers come and go",
     "A sub 1 /s 20; B sub 4 /s 20; sync; V pub 2 /s 20; sync; V publish 2 1; A drain 1; B take 4; "
     "A unsub 1;"
     "V sync; V publish 2 1; B release; B drain 4; B unsub 4; V sync; V publish 2 1; A sub 3 /s "
     "20; sync;"
     "V publish 2 1; A take 3; A unsub 3; V sync; V publish 2 1; A release; V sync; V unpub 2; V "
     "sync; V quit"},
    {"windows are added",
     "A sub 1 /s 30t; V pub 2 /s 30t; sync; V big 2 10; V arm; V big 2 2; V sync; V big 2 3; A "
     "take 1;"
     "A drain 1; V big 2 1; V unpub 2; V sync; V quit; A release; A drain 1; A unsub 1"},
    {"windows of another are added",
     "B pub 3 /w 30t; A sub 1 /w 30t; sync; B big 3 10; V sub 4 /w 30t; V sync; V take 4; B big 3 "
     "4; V sync;"
     "V drain 4; V release; V unsub 4; V sync; V quit; A drain 1; B unpub 3; A unsub 1"},
};

std::uint64_t number_of(const char* name, std::uint64_t otherwise) {
  const char* const text = std::getenv(name);
  return text != nullptr ? std::strtoull(text, nullptr, 0) : otherwise;
}

struct Totals {
  std::uint64_t points = 0, deaths = 0, survived = 0;
  std::set<Step> died_at;
  std::vector<std::string> violations;
};

/// Deaths at first, first + stride, …
Totals sweep(const Script& script, SweepStage& stage, std::uint64_t first, std::uint64_t stride) {
  Totals totals;
  Performance performance(stage, script);
  std::string wrong = performance.rehearse();
  for (std::uint64_t n = first; wrong.empty(); n += stride) {
    const Performance::Ended ended = performance.perform(n);
    totals.points = performance.points();
    if (!ended.wrong.empty()) {
      wrong = "death at point " + std::to_string(n) +
              (ended.died_at ? std::string(" (") + name_of(*ended.died_at) + ")" : "") + ": " +
              ended.wrong;
    } else if (ended.died_at) {
      ++totals.deaths;
      totals.died_at.insert(*ended.died_at);
    } else if (n > performance.points()) {
      break;
    } else {
      ++totals.survived;  // fewer looks of the control thread than in the rehearsal
    }
  }
  if (!wrong.empty()) totals.violations.push_back(std::string(script.name) + ": " + wrong);
  return totals;
}

TEST(ClientSweep, AProcessKilledAtAnyPointDisturbsNobodyAndLeavesNothing) {
  const std::uint64_t stride = std::max<std::uint64_t>(1, number_of("AGNOCAST_SWEEP_STRIDE", 1));
  const std::uint64_t only = number_of("AGNOCAST_SWEEP_SCRIPT", 0);
  constexpr unsigned worker_count = 2;
  Totals sum;
  for (std::size_t i = 0; i < std::size(scripts); ++i) {
    if (only != 0 && only != i + 1) continue;
    const auto begin = std::chrono::steady_clock::now();
    // Made in this thread: a daemon dies with the thread that started it.
    std::vector<std::unique_ptr<SweepStage>> stages;
    std::vector<Totals> parts(worker_count);
    for (unsigned w = 0; w < worker_count; ++w) stages.push_back(std::make_unique<SweepStage>());
    std::vector<std::thread> workers;
    for (unsigned w = 0; w < worker_count; ++w) {
      workers.emplace_back([&, w] {
        parts[w] = sweep(scripts[i], *stages[w], 1 + w * stride, stride * worker_count);
      });
    }
    for (std::thread& worker : workers) worker.join();
    Totals total;
    for (unsigned w = 0; w < worker_count; ++w) {
      total.points = std::max(total.points, parts[w].points);
      total.deaths += parts[w].deaths;
      total.survived += parts[w].survived;
      total.died_at.merge(parts[w].died_at);
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
    sum.deaths += total.deaths;
    sum.survived += total.survived;
    sum.died_at.merge(total.died_at);
    sum.violations.insert(sum.violations.end(), total.violations.begin(), total.violations.end());
  }
  std::printf(
      "clients: %ju points (every %ju. of them tried), %ju deaths, %ju not reached again, "
      "%zu violations\n",
      std::uintmax_t{sum.points}, std::uintmax_t{stride}, std::uintmax_t{sum.deaths},
      std::uintmax_t{sum.survived}, sum.violations.size());
  std::string missed;
  for (std::uint16_t s = 0; s < static_cast<std::uint16_t>(Step::count); ++s) {
    const Step step{s};
    if (name_of(step)[0] == 'C' && sum.died_at.count(step) == 0)
      missed += std::string(" ") + name_of(step);
  }
  std::printf("nobody died at:%s\n", missed.empty() ? " (every C_ name was hit)" : missed.c_str());
  if (stride == 1 && only == 0) {
    EXPECT_EQ(missed, "") << "a named place that no script reaches";
  }
}

}  // namespace
}  // namespace agnocast::sweep
