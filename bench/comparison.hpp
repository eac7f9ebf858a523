// SPDX-License-Identifier: Apache-2.0
//
// Comparison: several systems under one plan, interleaved: A B C, B C A, … so that a disturbance
// of the machine meets all of them, and none is always the first. It compares ratios to the floor
// of the same round, and the median of these over the rounds.
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

/// Results of one system in all rounds.
struct Series {
  const System* system = nullptr;
  std::vector<Times> rounds;

  /// Return medians over the rounds of each round's median: of the slowest receiver's latencies,
  /// or of the publish calls.
  double p50_ns() const;
  double publish_p50_ns() const;
  /// Return medians over the rounds: of the mean of eight publish calls in a row, because small
  /// messages have one expensive call in eight (docs/protocol.md, deferred scan), and of the
  /// sender's processor time per message.
  double publish_of_eight_ns() const;
  double sender_cpu_ns() const;
  /// Returns the latencies of all rounds: a tail needs all samples.
  std::vector<double> latencies_ns() const;
  double p99_ns() const;
  /// Return, for each round, this system's figure over the other's: p50, publish_of_eight,
  /// sender_cpu.
  std::vector<double> ratios_to(const Series& other) const;
  std::vector<double> publish_ratios_to(const Series& other) const;
  std::vector<double> sender_cpu_ratios_to(const Series& other) const;
  /// Returns, for each round, this system's p50 less the other's, in nanoseconds.
  std::vector<double> differences_to(const Series& other) const;
  /// Return medians of the ratios over the rounds.
  double ratio_to(const Series& other) const { return median(ratios_to(other)); }
  double publish_ratio_to(const Series& other) const { return median(publish_ratios_to(other)); }
  /// Returns p99_ns() over the other's, with its 95 % interval.
  double p99_ratio_to(const Series& other) const;
  Interval p99_ratio_interval(const Series& other) const;
  /// Returns whether real-time scheduling was refused in any round.
  bool is_without_fifo() const;
};

struct Comparison {
  Plan plan;
  std::vector<Series> series;

  /// Null: it took no part.
  const Series* find(std::string_view system) const;
};

/// Returns those of `names` that this build has, the run requests and whose service runs here, in
/// the build's order. `floor` always takes part.
std::vector<const System*> chosen(const Run& run, const std::vector<std::string_view>& names,
                                  std::string_view floor, Services& services);
/// Returns all of systems().
std::vector<std::string_view> all_names();

/// A measurement under one title: all systems under all plans, for a number of rounds.
struct Measurement {
  std::string title;
  std::vector<const System*> systems;
  std::vector<Plan> plans;
  std::size_t rounds = 1;
  std::string_view floor;
  nlohmann::json extra = {};  ///< added to each result

  std::size_t steps() const { return systems.size() * plans.size() * rounds; }
};

/// Progress of a case with several measurements.
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
/// Runs one turn of a system. If a peer fails, calls leave_out() and returns false, so that the
/// results of the others are not lost. If a floor or agnocast fails, throws the exception of
/// `turn`.
bool takes_its_turn(const System& system, const std::function<void()>& turn);

/// Interleaves several plans: in each round every plan, under each plan every system, so that
/// compared plans are not minutes apart either. Calls `step` before each turn. A system that
/// fails one is left out of all of it.
std::vector<Comparison> compare(const std::vector<const System*>& systems,
                                const std::vector<Plan>& plans, std::size_t rounds,
                                Services& services,
                                const std::function<void(const System&, const Plan&)>& step);

/// Prints the table of a comparison, and adds an object of "results" for each system; `extra` is
/// added to these.
void tell(const Comparison& comparison, std::string_view floor, const nlohmann::json& extra,
          Report& report);

/// Does both; the table of each plan has the title and its size.
std::vector<Comparison> compare_and_tell(const Measurement& measurement, Services& services,
                                         Steps& steps, Report& report);

/// Returns one violin for each system.
nlohmann::json violins(const Comparison& comparison);
/// Returns a plot of the medians by size, a line for each system. One comparison a size.
Plot lines_by_size(const std::vector<Comparison>& by_size, const std::string& name,
                   const std::string& title);

/// The basis of a figure. If it is too small, an aim is not judged.
struct Basis {
  static constexpr std::size_t enough_for_p50 = 50, enough_for_p99 = 500;
  std::size_t messages = SIZE_MAX;  ///< per round; SIZE_MAX for figures without messages
  std::size_t enough = enough_for_p50;
  bool is_without_fifo = false;  ///< on one core the order of processes is then chance
  bool is_of_rounds = true;      ///< false: --rounds means something else
};
/// Returns the basis of a ratio of two systems in it.
Basis basis_of(const Comparison& comparison, std::size_t enough = Basis::enough_for_p50);

/// The project's aims, beside the measured figures.
class Aims {
 public:
  enum class Sense { at_most, at_least };
  explicit Aims(const Run& run) : run_(run) {}
  /// Adds an aim. Without `measured`: a necessary system did not run here. With an interval it is
  /// reached, or missed, if all of the interval is on one side of the bound, and undecided
  /// otherwise.
  void add(const std::string& aim, std::optional<double> measured, Sense sense, double bound,
           std::optional<Interval> interval = {}, const Basis& basis = {});
  /// Adds the median of a figure per round, with its interval. Empty: not measured.
  void add_median(const std::string& aim, const std::vector<double>& of_rounds, Sense sense,
                  double bound, const Basis& basis = {});
  /// The same without a bound: information beside an aim.
  void add_information(const std::string& what, const std::vector<double>& of_rounds);
  /// Prints the table, and adds an object of "results" for each.
  void tell(Report& report) const;

 private:
  struct Aim {
    std::string text;
    std::optional<double> measured;
    Sense sense;
    std::optional<double> bound;
    std::optional<Interval> interval;
    Basis basis;
    /// Empty: undecided. Only for a measured one.
    std::optional<bool> is_reached() const;
  };
  std::string not_judged(const Aim& aim) const;
  const Run run_;
  std::vector<Aim> all_;
};

/// Formats a table: columns as wide as their widest cell, the first one aligned left, the others
/// right.
class Table {
 public:
  explicit Table(std::vector<std::string> head) : rows_{std::move(head)} {}
  void add(std::vector<std::string> row) { rows_.push_back(std::move(row)); }
  void say(Report& report) const;

 private:
  std::vector<std::vector<std::string>> rows_;
};

/// Formats with three significant digits: "0.123", "12.3", "1234".
std::string digits(double value);
inline std::string us(double ns) { return digits(ns / 1000); }

}  // namespace agnocast::bench
