// SPDX-License-Identifier: Apache-2.0

#include <bench/comparison.hpp>

#include <bench/environment.hpp>
#include <bench/options.hpp>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <set>
#include <stdexcept>
#include <utility>

namespace agnocast::bench {
namespace {

// Returns `of` of each round.
template <class Of>
double median_of(const std::vector<Times>& rounds, Of of) {
  std::vector<double> each;
  for (const Times& round : rounds) each.push_back(of(round));
  return median(std::move(each));
}

template <class Of>
std::vector<double> ratios(const std::vector<Times>& rounds, const std::vector<Times>& base,
                           Of of) {
  std::vector<double> ratios;
  for (std::size_t i = 0; i < std::min(rounds.size(), base.size()); ++i) {
    const double below = of(base[i]);
    if (below > 0) ratios.push_back(of(rounds[i]) / below);
  }
  return ratios;
}

double p50_of(const Times& round) { return median(round.slowest_ns()); }
double publish_p50_of(const Times& round) { return median(round.publish_ns); }
/// Returns the median of the means of each eight in a row; ignores the remainder at the end.
double publish_of_eight(const Times& round) {
  constexpr std::size_t cycle = 8;
  const std::vector<double>& calls = round.publish_ns;
  if (calls.size() < cycle) return mean(calls);
  std::vector<double> means;
  for (auto end = calls.begin() + cycle;; end += cycle) {
    means.push_back(mean({end - cycle, end}));
    if (calls.end() - end < static_cast<std::ptrdiff_t>(cycle)) return median(std::move(means));
  }
}
double sender_cpu_of(const Times& round) { return round.sender_cpu_ns; }

double p99_of(const std::vector<double>& samples) { return quantile(samples, 0.99); }

}  // namespace

double Series::p50_ns() const { return median_of(rounds, p50_of); }

double Series::publish_p50_ns() const { return median_of(rounds, publish_p50_of); }

double Series::publish_of_eight_ns() const { return median_of(rounds, publish_of_eight); }

double Series::sender_cpu_ns() const { return median_of(rounds, sender_cpu_of); }

double Series::p99_ns() const { return p99_of(latencies_ns()); }

std::vector<double> Series::latencies_ns() const {
  std::vector<double> all;
  for (const Times& round : rounds) {
    const std::vector<double> some = round.slowest_ns();
    all.insert(all.end(), some.begin(), some.end());
  }
  return all;
}

std::vector<double> Series::ratios_to(const Series& other) const {
  return ratios(rounds, other.rounds, p50_of);
}

std::vector<double> Series::publish_ratios_to(const Series& other) const {
  return ratios(rounds, other.rounds, publish_of_eight);
}

std::vector<double> Series::sender_cpu_ratios_to(const Series& other) const {
  return ratios(rounds, other.rounds, sender_cpu_of);
}

std::vector<double> Series::differences_to(const Series& other) const {
  std::vector<double> differences;
  for (std::size_t i = 0; i < std::min(rounds.size(), other.rounds.size()); ++i)
    differences.push_back(p50_of(rounds[i]) - p50_of(other.rounds[i]));
  return differences;
}

double Series::p99_ratio_to(const Series& other) const { return p99_ns() / other.p99_ns(); }

Interval Series::p99_ratio_interval(const Series& other) const {
  const auto by_round = [](const Series& series) {
    std::vector<std::vector<double>> all;
    for (const Times& round : series.rounds) all.push_back(round.slowest_ns());
    return all;
  };
  return bootstrap_ratio(by_round(*this), by_round(other), p99_of);
}

bool Series::is_without_fifo() const {
  return std::any_of(rounds.begin(), rounds.end(),
                     [](const Times& round) { return round.is_without_fifo; });
}

const Series* Comparison::find(std::string_view system) const {
  for (const Series& one : series) {
    if (one.system->name == system) return &one;
  }
  return nullptr;
}

std::vector<const System*> chosen(const Run& run, const std::vector<std::string_view>& names,
                                  std::string_view floor, Services& services) {
  std::vector<const System*> all;
  for (const System& system : systems()) {
    const auto is_in = [&system](const auto& list) {
      return std::find(list.begin(), list.end(), system.name) != list.end();
    };
    const bool is_wanted =
        system.name == floor || (is_in(names) && (run.systems.empty() || is_in(run.systems)));
    if (is_wanted && services.has(system.service)) all.push_back(&system);
  }
  return all;
}

std::vector<std::string_view> all_names() {
  std::vector<std::string_view> names;
  for (const System& system : systems()) names.push_back(system.name);
  return names;
}

bool is_peer(const System& system) {
  return system.name.starts_with("iceoryx") || system.name.starts_with("cyclonedds") ||
         system.name.starts_with("rclcpp");
}

bool takes_its_turn(const System& system, const std::function<void()>& turn) {
  try {
    turn();
    return true;
  } catch (const std::runtime_error& error) {
    if (!is_peer(system)) throw;
    leave_out(std::string(system.name) +
              " has failed and is left out of that table: " + error.what());
    return false;
  }
}

std::vector<Comparison> compare(const std::vector<const System*>& systems,
                                const std::vector<Plan>& plans, std::size_t rounds,
                                Services& services,
                                const std::function<void(const System&, const Plan&)>& step) {
  std::vector<Series> series;
  for (const System* const system : systems) series.push_back({system, {}});
  std::vector<Comparison> all;
  for (const Plan& plan : plans) all.push_back({plan, series});
  std::set<const System*> failed;
  for (std::size_t round = 0; round < rounds; ++round) {
    for (Comparison& comparison : all) {
      const std::size_t count = comparison.series.size();
      for (std::size_t turn = 0; turn < count; ++turn) {
        Series& one = comparison.series[(round + turn) % count];
        if (failed.count(one.system) != 0) continue;
        step(*one.system, comparison.plan);
        const bool is_done = takes_its_turn(*one.system, [&] {
          one.rounds.push_back(conduct(*one.system, comparison.plan, services));
        });
        if (!is_done) failed.insert(one.system);
      }
    }
  }
  for (Comparison& comparison : all) {
    std::erase_if(comparison.series,
                  [&](const Series& one) { return failed.count(one.system) != 0; });
  }
  return all;
}

void tell(const Comparison& comparison, std::string_view floor, const nlohmann::json& extra,
          Report& report) {
  const Series* const base = comparison.find(floor);
  std::string refused;
  Table table({"system", "p50 us", "p99 us", "max us", "publish us", "of eight", "sender CPU us",
               "CV", "x " + std::string(floor)});
  for (const Series& one : comparison.series) {
    const std::vector<double> all = one.latencies_ns();
    const double max = quantile(all, 1), spread = variation(all);
    const bool has_p99 = all.size() >= p99_samples_min;
    const double ratio = base == nullptr ? 0 : one.ratio_to(*base);
    table.add({std::string(one.system->name), us(one.p50_ns()), has_p99 ? us(one.p99_ns()) : "-",
               us(max), us(one.publish_p50_ns()), us(one.publish_of_eight_ns()),
               us(one.sender_cpu_ns()), digits(spread), digits(ratio)});
    nlohmann::json result = {{"system", one.system->name},
                             {"size_bytes", comparison.plan.bytes},
                             {"receivers", comparison.plan.receivers},
                             {"rounds", one.rounds.size()},
                             {"period_ns", comparison.plan.period_ns},
                             {"samples", all.size()},
                             {"min_ns", quantile(all, 0)},
                             {"p50_ns", one.p50_ns()},
                             {"max_ns", max},
                             {"publish_p50_ns", one.publish_p50_ns()},
                             {"publish_of_eight_ns", one.publish_of_eight_ns()},
                             {"sender_cpu_ns", one.sender_cpu_ns()},
                             {"variation", spread}};
    if (has_p99) result["p99_ns"] = one.p99_ns();
    if (base != nullptr) {
      result["ratio_to_floor"] = ratio;
      result["floor"] = floor;
    }
    if (comparison.plan.cores != Cores::anywhere)
      result["cores"] = comparison.plan.cores == Cores::one ? 1 : 2;
    if (one.is_without_fifo()) {
      result["is_without_fifo"] = true;
      refused += " " + std::string(one.system->name);
    }
    result.update(extra);
    report.add(std::move(result));
  }
  table.say(report);
  if (!refused.empty()) report.say("  SCHED_FIFO was refused:" + refused);
}

std::vector<Comparison> compare_and_tell(const Measurement& measurement, Services& services,
                                         Steps& steps, Report& report) {
  const auto title_of = [&](const Plan& plan) {
    return measurement.title + ", " + size_text(plan.bytes);
  };
  std::vector<Comparison> comparisons =
      compare(measurement.systems, measurement.plans, measurement.rounds, services,
              [&](const System& system, const Plan& plan) {
                steps.next(title_of(plan) + ", " + std::string(system.name));
              });
  for (const Comparison& comparison : comparisons) {
    const Plan& plan = comparison.plan;
    const std::string whose = plan.receivers > 1 ? "; times are of the slowest receiver" : "";
    report.say("\n" + title_of(plan) + ", every " +
               digits(static_cast<double>(plan.period_ns) / 1e6) + " ms, " +
               std::to_string(measurement.rounds) + " x " + std::to_string(plan.messages) +
               " messages" + whose);
    tell(comparison, measurement.floor, measurement.extra, report);
  }
  return comparisons;
}

nlohmann::json violins(const Comparison& comparison) {
  nlohmann::json series = nlohmann::json::array();
  for (const Series& one : comparison.series) {
    std::vector<double> values_us = one.latencies_ns();
    for (double& value : values_us) value /= 1000;
    series.push_back({{"label", one.system->name}, {"values", values_us}});
  }
  return series;
}

Plot lines_by_size(const std::vector<Comparison>& by_size, const std::string& name,
                   const std::string& title) {
  std::map<std::string, nlohmann::json> lines;
  for (const Comparison& one : by_size) {
    for (const Series& series : one.series) {
      nlohmann::json& line = lines[std::string(series.system->name)];
      line["x"].push_back(one.plan.bytes);
      line["y"].push_back(series.p50_ns() / 1000);
    }
  }
  Plot plot{.name = name,
            .kind = "lines",
            .title = title,
            .x_label = "payload, bytes",
            .y_label = "microseconds",
            .log_x = true,
            .log_y = true};
  for (auto& [system, line] : lines) {
    line["label"] = system;
    plot.series.push_back(line);
  }
  return plot;
}

Basis basis_of(const Comparison& comparison, std::size_t enough) {
  const bool is_refused =
      std::any_of(comparison.series.begin(), comparison.series.end(),
                  [](const Series& series) { return series.is_without_fifo(); });
  return {.messages = comparison.plan.messages,
          .enough = enough,
          .is_without_fifo = is_refused && comparison.plan.cores == Cores::one};
}

void Aims::add(const std::string& aim, std::optional<double> measured, Sense sense, double bound,
               std::optional<Interval> interval, const Basis& basis) {
  all_.push_back({aim, measured, sense, bound, interval, basis});
}

void Aims::add_median(const std::string& aim, const std::vector<double>& of_rounds, Sense sense,
                      double bound, const Basis& basis) {
  if (of_rounds.empty()) return add(aim, {}, sense, bound);
  add(aim, median(of_rounds), sense, bound, median_interval(of_rounds), basis);
}

void Aims::add_information(const std::string& what, const std::vector<double>& of_rounds) {
  std::optional<double> measured;
  std::optional<Interval> interval;
  if (!of_rounds.empty()) measured = median(of_rounds), interval = median_interval(of_rounds);
  all_.push_back({what, measured, Sense::at_most, {}, interval, {}});
}

std::optional<bool> Aims::Aim::is_reached() const {
  const bool is_at_most = sense == Sense::at_most;
  const Interval all = interval.value_or(Interval{*measured, *measured});
  if (is_at_most ? all.high <= *bound : all.low >= *bound) return true;
  if (is_at_most ? all.low > *bound : all.high < *bound) return false;
  return {};
}

std::string Aims::not_judged(const Aim& aim) const {
  if (!aim.measured) return "not measured";
  if (!aim.bound) return "no aim, for comparison";
  const Basis& basis = aim.basis;
  if (run_.is_small || basis.messages < basis.enough ||
      (basis.is_of_rounds && !run_.has_enough_rounds()))
    return "not judged, too short a run";
  if (run_.has_assertions) return "not judged, a build with assertions";
  if (basis.is_without_fifo) return "not judged, SCHED_FIFO was refused";
  return aim.is_reached() ? "" : "undecided, the bound is within the interval";
}

void Aims::tell(Report& report) const {
  if (all_.empty()) return;
  report.say("\naims");
  Table table({"aim", "measured", "bound", "reached"});
  for (const Aim& aim : all_) {
    nlohmann::json result = {{aim.bound ? "aim" : "beside_aims", aim.text}};
    if (aim.bound) result["bound"] = *aim.bound;
    std::string measured = "-", verdict = not_judged(aim);
    if (aim.measured) {
      result["measured"] = *aim.measured;
      measured = digits(*aim.measured);
    }
    if (aim.interval) {
      result["measured_low"] = aim.interval->low;
      result["measured_high"] = aim.interval->high;
      measured += " [" + digits(aim.interval->low) + ", " + digits(aim.interval->high) + "]";
    }
    if (verdict.empty()) {
      const bool is_reached = *aim.is_reached();
      result["is_reached"] = is_reached;
      verdict = is_reached ? "yes" : "no";
    } else {
      result["not_judged"] = verdict;
    }
    const std::string bound =
        aim.bound ? (aim.sense == Sense::at_most ? "<= " : ">= ") + digits(*aim.bound) : "-";
    table.add({aim.text, measured, bound, verdict});
    report.add(std::move(result));
  }
  table.say(report);
}

void Table::say(Report& report) const {
  std::vector<std::size_t> widths;
  for (const auto& row : rows_) {
    widths.resize(std::max(widths.size(), row.size()));
    for (std::size_t i = 0; i < row.size(); ++i) widths[i] = std::max(widths[i], row[i].size());
  }
  for (const auto& row : rows_) {
    std::string line = " ";
    for (std::size_t i = 0; i < row.size(); ++i) {
      const std::string space(widths[i] - row[i].size(), ' ');
      line += i == 0 ? " " + row[i] + space : "  " + space + row[i];
    }
    report.say(line);
  }
}

std::string digits(double value) {
  char text[64];
  const double size = std::fabs(value);
  const int behind = size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3;
  std::snprintf(text, sizeof text, "%.*f", behind, value);
  return text;
}

}  // namespace agnocast::bench
