// SPDX-License-Identifier: Apache-2.0
//
// Goal: the daemon may be killed at any crash point, once and again while it resumes, and no
// process notices; a process and the daemon that recovers it may be killed together. Method: the
// scripts of sweep_clients with real processes. The daemon's worker is killed at its n-th crash
// point and restarted by its supervisor:
//   - alone: every answer that a process gets, every message and every place is the same as
//     without the death; nothing remains;
//   - twice: the next daemon also dies, a few points later, mostly while it resumes;
//   - while it takes the window of a process that comes from a lost store: at every point;
//   - while it recreates doorbells whose names were removed: at every point from its start;
//   - at every named crash point at least once, and from the decision of a revocation on;
//   - pairs: V dies at its n-th point, the daemon at the m-th point of the reap, with the
//     requirements of sweep_clients;
//   - pairs of a publish: V dies at each of its steps, the daemon at every 7th point of the
//     reap, with a different start for each step.
// AGNOCAST_SWEEP=all: every point, and all pairs of every script. Otherwise a sample;
// AGNOCAST_SEED chooses another one, AGNOCAST_ROTATION a part of it (tests/support/rotation.hpp).
// The test prints the total number.

#include <tests/recovery/sweep_script.hpp>
#include <tests/recovery/sweep_scripts.hpp>
#include <tests/support/rotation.hpp>
#include <tests/support/wire/unix_peers.hpp>

#include <gtest/gtest.h>
#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::sweep {
namespace {

constexpr unsigned worker_count = 2;
/// Counted from 1; 0: all scripts.
std::uint64_t only_script() { return number_of("AGNOCAST_SWEEP_SCRIPT", 0); }

/// Every `stride`-th of many points, from AGNOCAST_SEED on, and of these the part of
/// AGNOCAST_ROTATION: with six parts or a multiple, every sixth script, because the rehearsal of a
/// script takes as long as several deaths, and the more parts, the fewer of its points.
class Sample {
 public:
  explicit Sample(std::uint64_t stride) : stride_(stride) {
    std::printf("rotation: %s\n", rotation_.text().c_str());
  }
  bool takes(std::size_t script) const {
    return only_script() != 0 ? only_script() == script + 1
                              : script % script_parts_ == rotation_.part() % script_parts_;
  }
  /// Numbers the points of all runs together; `i` is the i-th of this one, from 0. Scripts begin
  /// with different parts, so that a run has about as many points as any other.
  std::uint64_t number(std::size_t script, std::uint64_t i) const {
    return (rotation_.part() + script) / script_parts_ % point_parts_ + i * point_parts_;
  }
  std::uint64_t at(std::size_t script, std::uint64_t i) const {
    return seed_ % stride_ + number(script, i) * stride_;
  }
  std::uint64_t seed() const { return seed_; }
  std::uint64_t parts() const { return rotation_.parts(); }

 private:
  const test::Rotation rotation_;
  const std::uint64_t script_parts_ = rotation_.parts() % 6 == 0 ? 6 : 1,
                      point_parts_ = rotation_.parts() / script_parts_;
  const std::uint64_t stride_, seed_ = number_of("AGNOCAST_SEED", 0);
};

/// A part of AGNOCAST_ROTATION has every fourth point of a short sequence, from here,
/// where four or a multiple of that are the parts.
struct Quarter {
  const test::Rotation rotation;
  const std::uint64_t step = rotation.parts() % 4 == 0 ? 4 : 1, from = rotation.part() % step;
};

struct Totals {
  std::uint64_t points = 0, deaths = 0, both = 0;
  std::set<Step> died_at;
  std::map<Step, std::uint64_t> daemon_died_at;  // of pairs
  std::vector<std::string> violations;

  void note(const Script& script, const Performance::Ended& ended, const std::string& what) {
    if (!ended.wrong.empty()) {
      violations.push_back(
          std::string(script.name) + ": " + what +
          (ended.died_at ? std::string(" (") + name_of(*ended.died_at) + ")" : "") + ": " +
          ended.wrong);
    } else if (ended.died_at) {
      ++deaths;
      died_at.insert(*ended.died_at);
      if (ended.daemon_died_at) ++both, ++daemon_died_at[*ended.daemon_died_at];
    }
  }
  void add(const Totals& other) {
    points += other.points;
    deaths += other.deaths;
    both += other.both;
    died_at.insert(other.died_at.begin(), other.died_at.end());
    for (const auto& [step, count] : other.daemon_died_at) daemon_died_at[step] += count;
    violations.insert(violations.end(), other.violations.begin(), other.violations.end());
  }
};

/// Runs `sweep(script, performance, worker, totals)` for each script of the sample in as many
/// threads as there are workers, on a performance that was rehearsed. `script` counts from 0.
using SweepOfScript =
    std::function<void(std::size_t script, Performance&, std::uint64_t worker, Totals&)>;
Totals sweep_scripts(const char* what, const Sample& sample, const SweepOfScript& sweep) {
  Totals sum;
  for (std::size_t i = 0; i < std::size(scripts); ++i) {
    if (!sample.takes(i)) continue;
    const auto begin = std::chrono::steady_clock::now();
    std::vector<std::unique_ptr<SweepStage>>
        stages;  // a daemon dies with the thread that started it
    for (unsigned w = 0; w < worker_count; ++w) stages.push_back(std::make_unique<SweepStage>());
    std::vector<Totals> parts(worker_count);
    std::vector<std::thread> workers;
    for (unsigned w = 0; w < worker_count; ++w)
      workers.emplace_back([&, w] {
        Performance performance(*stages[w], scripts[i]);
        if (const std::string wrong = performance.rehearse(); !wrong.empty())
          parts[w].violations.push_back(std::string(scripts[i].name) + ": " + wrong);
        else
          sweep(i, performance, w, parts[w]);
      });
    for (std::thread& worker : workers) worker.join();
    Totals total;
    for (unsigned w = 0; w < worker_count; ++w) {
      for (const std::string& violation : parts[w].violations)
        ADD_FAILURE() << violation << "\nagnocastd wrote:\n" << stages[w]->daemon().log();
      total.add(parts[w]);
    }
    total.points /= worker_count;  // each worker counts all
    std::printf("%-62s %6ju %s, %5ju deaths at %2zu names, %zu violations, %5.1f s\n",
                scripts[i].name, std::uintmax_t{total.points}, what, std::uintmax_t{total.deaths},
                total.died_at.size(), total.violations.size(),
                std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
    std::fflush(stdout);
    sum.add(total);
  }
  std::printf("daemon: %ju %s, %ju deaths, %zu violations\n", std::uintmax_t{sum.points}, what,
              std::uintmax_t{sum.deaths}, sum.violations.size());
  return sum;
}

void print_places(const Totals& totals) {
  std::string text;
  for (const auto& [step, count] : totals.daemon_died_at)
    text += std::string(" ") + name_of(step) + " " + std::to_string(count);
  std::printf("the daemon died at:%s\n", text.c_str());
}

TEST(DaemonSweep, NoProcessNoticesADaemonKilledAtAnyPointOnceOrTwice) {
  const bool all = runs_everything();
  const Sample sample(all ? 1 : number_of("AGNOCAST_SWEEP_STRIDE", 47));
  const Totals sum = sweep_scripts(
      "points", sample,
      [&](std::size_t number, Performance& performance, std::uint64_t worker, Totals& totals) {
        totals.points = performance.daemon_points();
        for (std::uint64_t i = worker;
             sample.at(number, i) < totals.points && totals.violations.empty(); i += worker_count) {
          const std::uint64_t n = 1 + sample.at(number, i);
          // Every second time the next daemon dies too, sooner or later.
          const bool dies_again = sample.number(number, i) / worker_count % 2 != 0;
          const std::uint64_t then = dies_again ? 1 + (n * 7 + sample.seed()) % 60 : 0;
          totals.note(scripts[number], performance.perform_daemon(n, then),
                      "the daemon's death at point " + std::to_string(n) + ", then " +
                          std::to_string(then));
        }
      });
  EXPECT_GT(sum.deaths, only_script() != 0 ? 0u : 100u / sample.parts());
}

/// Returns the steps at which the daemon can die.
std::set<Step> steps_of_daemon() {
  std::set<Step> found;
  for (const NamedStep& named : journal_steps) found.insert(named.step);
  for (const NamedStep& named : daemon_steps) found.insert(named.step);
  // Steps of rule RU: decisions, and what clients do.
  for (const Step step : {steps::R2_generation, steps::R4_reusable, steps::R5_again, steps::R6_link,
                          steps::R7_unlinked})
    found.erase(step);
  return found;
}

/// V dies and leaves its interrupted publish behind; the daemon dies when it reaches `step`.
const Script interrupted_publish{
    "a publish, and what its death leaves",
    "A cb 1 /s 20; B sub 4 /s 20; sync; V pub 2 /s 1; V sub 3 /t 20; sync; V publish 2 2; A sync; "
    "B sync; V arm; V publish 2 1; V quit; A heard 1; B drain 4; A unsub 1; B unsub 4"};

// Covers every name, whether or not the sample of points has hit it.
TEST(DaemonSweep, NoProcessNoticesADaemonsDeathAtAnyNamedPoint) {
  std::set<Step> left = steps_of_daemon();
  std::uint64_t deaths = 0;
  {
    // Reached only after a death in the middle of a publish.
    SweepStage stage;
    Performance performance(stage, interrupted_publish);
    ASSERT_EQ(performance.rehearse(), "");
    for (const Step step : {steps::D3_slot, steps::D3_order, steps::D3_intent}) {
      const Performance::Ended ended = performance.perform_pair_at(steps::P5_head, step);
      ASSERT_EQ(ended.wrong, "") << "death at " << name_of(step) << "\nagnocastd wrote:\n"
                                 << stage.daemon().log();
      if (ended.daemon_died_at == step) left.erase(step), ++deaths;
    }
  }
  // The later scripts do more to the daemon; scripts that kill it anyway are slow.
  for (std::size_t i = std::size(scripts); i-- > 0 && !left.empty();) {
    if (only_script() != 0 && only_script() != i + 1) continue;
    if (scripts[i].loses_store() ||
        std::string(scripts[i].commands).find("restart;") != std::string::npos)
      continue;
    SweepStage stage;
    Performance performance(stage, scripts[i]);
    ASSERT_EQ(performance.rehearse(), "") << scripts[i].name;
    for (auto step = left.begin(); step != left.end();) {
      const Performance::Ended ended = performance.perform_daemon_from(*step, 1);
      ASSERT_EQ(ended.wrong, "") << scripts[i].name << ": death at " << name_of(*step)
                                 << "\nagnocastd wrote:\n"
                                 << stage.daemon().log();
      deaths += ended.died_at.has_value();
      step = ended.died_at ? left.erase(step) : std::next(step);
    }
  }
  std::string missed;
  for (const Step step : left) missed += std::string(" ") + name_of(step);
  std::printf("named places: %ju deaths, nobody died at:%s\n", std::uintmax_t{deaths},
              missed.empty() ? " (every name was hit)" : missed.c_str());
  if (only_script() == 0) {
    EXPECT_EQ(missed, "") << "a named crash point that no script reaches";
  }
}

// From the decision on: the process must not believe that its session lasts, nor keep anything.
TEST(DaemonSweep, TheNextDaemonCompletesARevocation) {
  const std::uint64_t stride =
      runs_everything() ? 1 : number_of("AGNOCAST_SWEEP_REVOKE_STRIDE", 17);
  const auto* const script =
      std::find_if(std::begin(scripts), std::end(scripts), [](const Script& one) {
        return std::string(one.commands).find("revoke") != std::string::npos;
      });
  ASSERT_NE(script, std::end(scripts));
  SweepStage stage;
  Performance performance(stage, *script);
  ASSERT_EQ(performance.rehearse(), "");
  std::uint64_t deaths = 0;
  for (std::uint64_t n = 1;; n += stride) {
    const Performance::Ended ended = performance.perform_daemon_from(steps::B_revoke, n);
    ASSERT_EQ(ended.wrong, "") << "death at point " << n << " of the revocation, "
                               << (ended.died_at ? name_of(*ended.died_at) : "none")
                               << "\nagnocastd wrote:\n"
                               << stage.daemon().log();
    if (!ended.died_at) break;
    ++deaths;
  }
  std::printf("revocation: %ju deaths, at every %ju. point of it and of what follows\n",
              std::uintmax_t{deaths}, std::uintmax_t{stride});
  EXPECT_GT(deaths, 10u);
}

TEST(DaemonSweep, AProcessAndTheDaemonThatRecoversItDieTogether) {
  const bool all = runs_everything();
  const Sample sample(all ? 1 : number_of("AGNOCAST_SWEEP_PAIR_STRIDE", 1999));
  const Totals sum = sweep_scripts(
      "pairs", sample,
      [&](std::size_t number, Performance& performance, std::uint64_t worker, Totals& totals) {
        const Script& script = scripts[number];
        // The length of a reap depends on what V owns by then: the longest is late, but not last.
        const Performance::Ended counted = performance.perform_pair(performance.points() / 2, 0);
        totals.note(script, counted, "a death in the middle");
        const std::uint64_t recovery_points = std::max<std::uint64_t>(1, counted.reap_points);
        totals.points = performance.points() * recovery_points;
        for (std::uint64_t i = worker;
             sample.at(number, i) < totals.points && totals.violations.empty(); i += worker_count) {
          const std::uint64_t pair = sample.at(number, i);
          const std::uint64_t n = pair / recovery_points + 1;
          const std::uint64_t m = pair % recovery_points + 1;
          totals.note(script, performance.perform_pair(n, m),
                      "deaths at points " + std::to_string(n) + " and " + std::to_string(m));
        }
      });
  std::printf("pairs: in %ju of them both died\n", std::uintmax_t{sum.both});
  print_places(sum);
  EXPECT_GT(sum.both, only_script() != 0 || sample.parts() != 1 ? 0u : 50u);
}

// The repaired queue and its records must not depend on how often the daemon started.
TEST(DaemonSweep, APublisherInAPublishAndTheDaemonThatRepairsItsQueueDieTogether) {
  const std::uint64_t stride =
      runs_everything() ? 1 : number_of("AGNOCAST_SWEEP_PUBLISH_STRIDE", 7);
  const Quarter quarter;
  std::vector<std::unique_ptr<SweepStage>> stages;
  for (unsigned w = 0; w < worker_count; ++w) stages.push_back(std::make_unique<SweepStage>());
  std::vector<Totals> parts(worker_count);
  const auto sweep = [&](unsigned w) {
    Totals& totals = parts[w];
    Performance performance(*stages[w], interrupted_publish);
    if (const std::string wrong = performance.rehearse(); !wrong.empty())
      return totals.violations.push_back(wrong);
    for (auto s = static_cast<std::uint16_t>(steps::P1_sequence);
         s <= static_cast<std::uint16_t>(steps::P11_idle); ++s) {
      const Step step{s};
      bool is_reached = true;
      if (s % worker_count != w) continue;
      // A different start for each step, so that together they cover all points.
      for (std::uint64_t m = 1 + (s / worker_count + number_of("AGNOCAST_SEED", 0)) % stride +
                             quarter.from * stride;
           is_reached && totals.violations.empty(); m += quarter.step * stride) {
        const Performance::Ended ended = performance.perform_pair_from(step, m);
        totals.note(interrupted_publish, ended,
                    "the daemon's death at point " + std::to_string(m) + " of the reap");
        is_reached = ended.daemon_died_at.has_value();
      }
    }
  };
  std::vector<std::thread> workers;
  for (unsigned w = 0; w < worker_count; ++w) workers.emplace_back(sweep, w);
  for (std::thread& worker : workers) worker.join();
  Totals sum;
  for (unsigned w = 0; w < worker_count; ++w) {
    for (const std::string& violation : parts[w].violations)
      ADD_FAILURE() << violation << "\nagnocastd wrote:\n" << stages[w]->daemon().log();
    sum.add(parts[w]);
  }
  std::printf(
      "pairs of a publish: V died at %zu steps, in %ju of %ju the daemon as well, at every %ju. "
      "point\n",
      sum.died_at.size(), std::uintmax_t{sum.both}, std::uintmax_t{sum.deaths},
      std::uintmax_t{stride * quarter.step});
  print_places(sum);
  EXPECT_GE(sum.died_at.size(), 15u);
  if (stride * quarter.step != 1) return;
  for (const Step step :
       {steps::D2_word, steps::D3_slot, steps::D3_order, steps::D3_intent, steps::D3_final_head,
        steps::D3_word, steps::D3_epoch, steps::R3_died, steps::B_ring, steps::B_doorbells_closed,
        steps::B_memory_closed, steps::B_vacate})
    EXPECT_GT(sum.daemon_died_at[step], 0u) << name_of(step);
}

// The daemon dies at any point of the creation of a publisher, which the next daemon answers and
// which then publishes and exits while its subscriber is stopped.
TEST(DaemonSweep, AnAnsweredPublisherIsHeardByASubscriberThatWasStopped) {
  SweepStage stage;
  const ControlPage page(stage.directory() + "/A"), victims(stage.directory() + "/V");
  const auto subscriber = stage.make(page);
  ASSERT_EQ(subscriber->ask("sub 1 /s 20"), "ok");
  ASSERT_EQ(subscriber->ask("sync"), "ok");
  stage.set_living(1);
  const Quarter quarter;
  std::uint64_t deaths = 0;
  for (std::uint64_t n = 1 + quarter.from;; n += quarter.step) {
    auto publisher = stage.make(victims);
    ASSERT_EQ(publisher->ask("sync"), "ok");  // hello is over
    const pid_t pid = publisher->pid();
    ::kill(subscriber->pid(), SIGSTOP);
    stage.daemon_control().arm_from(steps::B_head, n);
    const auto created = publisher->ask("pub 2 /s 20");
    const auto published = publisher->ask("publish 2 1");
    publisher->tell("quit");
    const bool ended = publisher->wait_for_end();
    stage.daemon_control().disarm();
    const bool recovered = stage.wait_until_recovered(pid);
    const auto died_at = stage.daemon_control().died_at();
    ::kill(subscriber->pid(), SIGCONT);
    const std::string where =
        "point " + std::to_string(n) + (died_at ? std::string(", ") + name_of(*died_at) : "");
    ASSERT_EQ(created, "ok") << where;
    ASSERT_EQ(published, "1") << where;
    ASSERT_TRUE(ended && recovered) << where;
    ASSERT_EQ(subscriber->ask("sync"), "ok") << where;
    ASSERT_EQ(subscriber->ask("drain 1"), "2:1 ") << where;
    if (!died_at) break;
    ++deaths;
  }
  std::printf("creation of a publisher: %ju deaths\n", std::uintmax_t{deaths});
  EXPECT_GT(deaths, 20u / quarter.step);
}

// The daemon dies at any point of the creation of a subscription. What is published after the next
// daemon has answered it reaches the subscription, which may not have linked by then, and nothing
// that was published before does.
TEST(DaemonSweep, AnAnsweredSubscriptionGetsWhatIsPublishedNext) {
  SweepStage stage;
  const ControlPage page(stage.directory() + "/A"), victims(stage.directory() + "/V");
  const auto publisher = stage.make(page);
  ASSERT_EQ(publisher->ask("pub 1 /s 20"), "ok");
  ASSERT_EQ(publisher->ask("sync"), "ok");
  stage.set_living(1);
  const Quarter quarter;
  std::uint64_t deaths = 0, number = 0;
  for (std::uint64_t n = 1 + quarter.from;; n += quarter.step) {
    ASSERT_EQ(publisher->ask("publish 1 1"), "1");
    number += 2;
    auto subscriber = stage.make(victims);
    ASSERT_EQ(subscriber->ask("sync"), "ok");  // hello is over
    const pid_t pid = subscriber->pid();
    stage.daemon_control().arm_from(steps::J3_word, n);
    const auto created = subscriber->ask("sub 2 /s 20");
    const auto published = publisher->ask("publish 1 1");
    const auto synchronized = subscriber->ask("sync");
    stage.daemon_control().disarm();
    const auto taken = subscriber->ask("drain 2");
    const auto died_at = stage.daemon_control().died_at();
    subscriber->tell("quit");
    const bool ended = subscriber->wait_for_end() && stage.wait_until_recovered(pid);
    const std::string where =
        "point " + std::to_string(n) + (died_at ? std::string(", ") + name_of(*died_at) : "");
    ASSERT_EQ(created, "ok") << where;
    ASSERT_EQ(published, "1") << where;
    ASSERT_EQ(synchronized, "ok") << where;
    ASSERT_EQ(taken, "1:" + std::to_string(number) + " ") << where;
    ASSERT_TRUE(ended) << where;
    if (!died_at) break;
    ++deaths;
  }
  std::printf("creation of a subscription: %ju deaths\n", std::uintmax_t{deaths});
  EXPECT_GT(deaths, 8u / quarter.step);
}

// A process whose daemon was lost brings its heap to the next one, which dies at any point of
// taking it. The daemon after that has the window once, at its place, and every message in it
// arrives.
TEST(DaemonSweep, ABroughtWindowExistsOnceWhereverItsDaemonDies) {
  SweepStage stage;
  const ControlPage first(stage.directory() + "/A"), second(stage.directory() + "/B");
  const auto subscriber = stage.make(first), publisher = stage.make(second);
  ASSERT_EQ(subscriber->ask("sub 1 /s 20"), "ok");
  ASSERT_EQ(publisher->ask("pub 2 /s 20"), "ok");
  const auto windows = [&] {
    std::vector<std::uint64_t> bases;
    const ctl::System system = stage.look_in_time();
    for (const auto& [index, process] : system.processes) {
      for (std::uint64_t w = 0; w < process.facts.window_count; ++w)
        bases.push_back(process.facts.window[w].base);
    }
    return bases;
  };
  const auto is_whole = [&] {
    const ctl::System system = stage.look_in_time();
    return system.topics.size() == 1 && system.topics.begin()->second.publishers.size() == 1 &&
           system.topics.begin()->second.subscriptions.size() == 1;
  };
  const std::vector<std::uint64_t> at_first = windows();
  ASSERT_EQ(at_first.size(), 1u);
  std::uint64_t number = 0;
  std::set<Step> died_at;
  // Returns whether a daemon died.
  const auto lose = [&](Step from, std::uint64_t n) {
    SCOPED_TRACE("point " + std::to_string(n) + " from " + name_of(from));
    stage.lose(from, n);
    EXPECT_TRUE(test::eventually(is_whole));
    const auto death = stage.daemon_control().died_at();
    SCOPED_TRACE(death ? name_of(*death) : "nobody died");
    EXPECT_EQ(windows(), at_first);
    EXPECT_EQ(publisher->ask("publish 2 1"), "1");
    // The publisher may have moved while the subscriber's thread is still moving.
    std::optional<std::string> heard;
    EXPECT_TRUE(test::eventually([&] { return (heard = subscriber->ask("drain 1")) != ""; }));
    EXPECT_EQ(heard, "2:" + std::to_string(++number) + " ");
    EXPECT_EQ(stage.verify(), "");
    EXPECT_EQ(stage.daemon().log().find(" client lost "), std::string::npos);
    if (death) died_at.insert(*death);
    return death.has_value();
  };
  std::uint64_t deaths = 0;
  while (lose(steps::B_window_base, deaths + 1) && !HasFailure()) ++deaths;
  std::printf("windows that are brought: %ju deaths at %zu names\n", std::uintmax_t{deaths},
              died_at.size());
  EXPECT_GE(died_at.size(), 10u);
  // Two processes bring their windows at the same time, in an order of their own in each run: a
  // count of points may miss a name. (Counted from another step, it may be one of the daemon's
  // start, after which its supervisor starts no other.)
  for (const Step step :
       {steps::B_window_base, steps::B_keep, steps::B_kept, steps::B_window_made}) {
    for (std::uint64_t i = 0; i < 5 * deaths && died_at.count(step) == 0 && !HasFailure(); ++i)
      lose(steps::B_window_base, i % deaths + 1);
    EXPECT_EQ(died_at.count(step), 1u) << name_of(step);
  }
}

/// A publisher of one user that rings a subscription of another, while daemons die and restart.
class DoorbellsOfTwoUsers {
 public:
  static constexpr uid_t other_uid = 65534;

  DoorbellsOfTwoUsers() {
    EXPECT_EQ(receiver_->ask("cb 1 /s 20"), "ok");
    EXPECT_EQ(sender_->ask("pub 2 /s 20"), "ok");
    // A sync makes a doorbell that is not used afterwards.
    EXPECT_EQ(receiver_->ask("sync"), "ok");
    EXPECT_EQ(sender_->ask("sync"), "ok");
    EXPECT_TRUE(test::eventually([&] { return !rung().empty(); })) << "there is no doorbell";
  }
  SweepStage& stage() { return stage_; }
  /// Kills the next daemon where `arm` says. Returns what is wrong, or nothing.
  std::string renew(const std::function<void(ControlPage&)>& arm) {
    const std::set<std::string> names = stage_.doorbell_names();
    const std::set<std::uint32_t> before = rung();
    if (!stage_.remove_doorbells_and_restart(arm))
      return "no doorbell had a name, or no daemon continues";
    const auto is_another = [&] {
      const std::set<std::uint32_t> now = rung();
      return now.size() == 1 && now != before;
    };
    if (!test::eventually(is_another)) return "its publisher cannot ring the new doorbell";
    stage_.daemon_control().disarm();
    // The daemon may have died after that.
    for (const auto* process : {&receiver_, &sender_}) {
      if ((*process)->ask("sync") != "ok") return "a process is not served";
    }
    if (!test::eventually(is_another)) return "its publisher can no longer ring the new doorbell";
    heard_ += "2:" + std::to_string(++number_) + " ";
    if (sender_->ask("publish 2 1") != "1") return "nothing is published";
    if (!test::eventually([&] { return receiver_->ask("heard 1") == heard_; }))
      return "heard " + receiver_->ask("heard 1").value_or("nothing") + ", wanted " + heard_;
    if (stage_.doorbell_names() != names) return "the names of the doorbells have changed";
    if (!test::eventually([&] { return is_audible(); }))
      return "the daemon takes the subscription for mute";
    if (stage_.daemon().log().find(" client lost ") != std::string::npos) return "client lost";
    return stage_.verify();
  }

 private:
  std::set<std::uint32_t> rung() const { return test::rung_by(sender_->pid(), receiver_->pid()); }
  bool is_audible() {
    const ctl::System system = stage_.look_in_time();
    return system.processes.size() == 2 &&
           std::all_of(system.processes.begin(), system.processes.end(),
                       [](const auto& entry) { return entry.second.facts.silent_wait_sets == 0; });
  }

  SweepStage stage_;
  ControlPage own_{stage_.directory() + "/A"}, others_{stage_.directory() + "/B"};
  std::unique_ptr<SweepProcess> receiver_ = stage_.make(own_);
  std::unique_ptr<SweepProcess> sender_ = stage_.make(others_, other_uid);
  std::uint64_t number_ = 0;
  std::string heard_;
};

// A cleaner has removed the names, and the daemon that finds none dies at any point while it
// resumes and recreates doorbells. After that the publisher of another user can ring the new
// doorbell.
TEST(DaemonSweep, ADoorbellIsRecreatedWhereverTheDaemonThatMakesItDies) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and a second uid";
  if (!test::datagram_peers()) GTEST_SKIP() << "needs the kernel's list of sockets";
  DoorbellsOfTwoUsers doorbells;
  ASSERT_FALSE(HasFailure());
  std::uint64_t deaths = 0;
  std::map<Step, std::uint64_t> died_at;
  // At each point up to the first doorbell, then at each from there on, whatever the order of
  // return.
  for (const bool is_behind : {false, true}) {
    for (std::uint64_t n = 1;; ++n) {
      const std::string wrong = doorbells.renew([&](ControlPage& daemon) {
        is_behind ? daemon.arm_from(steps::B_doorbell_bind, n)
                  : daemon.arm_until(steps::B_doorbell_bind, n);
      });
      const auto death = doorbells.stage().daemon_control().died_at();
      ASSERT_EQ(wrong, "") << "point " << n << (is_behind ? " behind" : " before")
                           << " the doorbell" << (death ? std::string(", ") + name_of(*death) : "")
                           << "\nagnocastd wrote:\n"
                           << doorbells.stage().daemon().log();
      if (!death) break;
      ++deaths;
      ++died_at[*death];
    }
  }
  std::printf("doorbells that are made anew: %ju deaths at %zu names\n", std::uintmax_t{deaths},
              died_at.size());
  for (const Step step : {steps::B_accepted, steps::B_doorbell_bind, steps::B_doorbell_bound,
                          steps::B_send, steps::B_sent})
    EXPECT_GT(died_at[step], 0u) << name_of(step);
}

}  // namespace
}  // namespace agnocast::sweep
