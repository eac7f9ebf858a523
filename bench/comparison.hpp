// SPDX-License-Identifier: Apache-2.0
//
// Comparison: several systems under one plan, interleaved: A B C, B C A, … so that whatever else the machine does meets
// all of them, and nobody is always the first. What is compared is the ratio to the floor of the same round, and the median of these over the rounds.
#pragma once

#include <bench/case.hpp>
#include <bench/conductor.hpp>
#include <bench/figures.hpp>

#include <cstddef>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::bench {

/// What one system gave in all rounds.
struct Series {
  const System* system = nullptr;
  std::vector<Times> rounds;

  /// Medians over the rounds of each round's median: of the slowest receiver's latencies, or of the publish calls.
  double p50_ns() const;
  double publish_p50_ns() const;
  /// Medians over the rounds: of the mean of eight publish calls in a row, as small messages have one dear call among seven cheap
  /// ones (docs/protocol.md, lazy pass), and of the sender's processor time of a message.
  double publish_of_eight_ns() const;
  double sender_cpu_ns() const;
  /// Over all rounds, as a tail wants all samples that there are.
  std::vector<double> latencies_ns() const;
  double p99_ns() const;
  /// Of each round by itself, its figure over the other's: p50, publish_of_eight, sender_cpu.
  std::vector<double> ratios_to(const Series& other) const;
  std::vector<double> publish_ratios_to(const Series& other) const;
  std::vector<double> sender_cpu_ratios_to(const Series& other) const;
  /// Medians of these over the rounds.
  double ratio_to(const Series& other) const { return median(ratios_to(other)); }
  double publish_ratio_to(const Series& other) const { return median(publish_ratios_to(other)); }
  /// p99_ns() over the other's, with its 95 % interval.
  double p99_ratio_to(const Series& other) const;
  Interval p99_ratio_interval(const Series& other) const;
  /// In any round: real-time scheduling was wanted and refused.
  bool is_without_fifo() const;
};

struct Comparison {
  Plan plan;
  std::vector<Series> series;

  /// Null: it did not take part.
  const Series* find(std::string_view system) const;
};

/// Those of `names` that this build has and the run wants, and whose service runs here, in the build's order. `floor` takes
/// part whatever the run wants.
std::vector<const System*> chosen(const Run& run, const std::vector<std::string_view>& names,
                                  std::string_view floor, Services& services);
/// All of systems().
std::vector<std::string_view> all_names();

/// What is measured under one title: all systems under all plans, so many rounds.
struct Measurement {
  std::string title;
  std::vector<const System*> systems;
  std::vector<Plan> plans;
  std::size_t rounds = 1;
  std::string_view floor;
  nlohmann::json extra = {};  ///< added to each result

  std::size_t steps() const { return systems.size() * plans.size() * rounds; }
};

/// How far a case is, which has more than one measurement.
class Steps {
 public:
  Steps(Report& report, std::size_t all) : report_(report), all_(all) {}
  void next(const std::string& what) { report_.progress(done_++, all_, what); }
  void finish() { report_.progress(all_, all_, ""); }

 private:
  Report& report_;
  std::size_t done_ = 0, all_;
};

bool is_peer(const System& system);
/// A turn of a system. False: it is a peer, and the turn failed, which leave_out() was told: the hour that the others have taken
/// is not to be lost with it. Where a floor or agnocast fails, this throws what `turn` has thrown.
bool takes_its_turn(const System& system, const std::function<void()>& turn);

/// Several plans in one go: in each round every plan, under each plan every system, so that what is compared between plans
/// is not minutes apart either. `step` is called before each turn. Whoever fails a turn is left out of all of it.
std::vector<Comparison> compare(const std::vector<const System*>& systems,
                                const std::vector<Plan>& plans, std::size_t rounds,
                                Services& services,
                                const std::function<void(const System&, const Plan&)>& step);

/// The table of a comparison, and an object of "results" for each system; `extra` is added to these.
void tell(const Comparison& comparison, std::string_view floor, const nlohmann::json& extra,
          Report& report);

/// Both; the table of each plan is under the title and its size.
std::vector<Comparison> compare_and_tell(const Measurement& measurement, Services& services,
                                         Steps& steps, Report& report);

/// One violin for each system.
nlohmann::json violins(const Comparison& comparison);

/// What a figure rests on. Of too little, an aim is not judged.
struct Basis {
  static constexpr std::size_t enough_for_p50 = 50, enough_for_p99 = 500;
  std::size_t messages = SIZE_MAX;  ///< of each round; what is not made of messages has enough
  std::size_t enough = enough_for_p50;
  bool is_without_fifo = false;  ///< on one core, where the order of processes is then chance
  bool is_of_rounds = true;      ///< false: --rounds is about something else
};
/// Of a ratio of two that took part in it.
Basis basis_of(const Comparison& comparison, std::size_t enough = Basis::enough_for_p50);

/// What the project has set itself, beside what was measured.
class Aims {
 public:
  enum class Sense { at_most, at_least };
  explicit Aims(const Run& run) : run_(run) {}
  /// Without `measured`: what it takes did not run here. With an interval it is reached, or missed, when all of that is on
  /// one side of the bound, and undecided otherwise.
  void add(const std::string& aim, std::optional<double> measured, Sense sense, double bound,
           std::optional<Interval> interval = {}, const Basis& basis = {});
  /// Of a figure of each round: their median, with its interval. None: not measured.
  void add_median(const std::string& aim, const std::vector<double>& of_rounds, Sense sense,
                  double bound, const Basis& basis = {});
  /// The same without a bound: what is to be seen beside an aim.
  void add_information(const std::string& what, const std::vector<double>& of_rounds);
  /// The table, and an object of "results" for each.
  void tell(Report& report) const;

 private:
  struct Aim {
    std::string text;
    std::optional<double> measured;
    Sense sense;
    std::optional<double> bound;
    std::optional<Interval> interval;
    Basis basis;
    /// Empty: undecided. Of one that was measured.
    std::optional<bool> is_reached() const;
  };
  std::string not_judged(const Aim& aim) const;
  const Run run_;
  std::vector<Aim> all_;
};

/// Text of a table: columns as wide as their widest cell, the first one left, the others right.
class Table {
 public:
  explicit Table(std::vector<std::string> head) : rows_{std::move(head)} {}
  void add(std::vector<std::string> row) { rows_.push_back(std::move(row)); }
  void say(Report& report) const;

 private:
  std::vector<std::vector<std::string>> rows_;
};

/// Three digits that count: "0.123", "12.3", "1234".
std::string digits(double value);
inline std::string us(double ns) { return digits(ns / 1000); }

}  // namespace agnocast::bench
