// SPDX-License-Identifier: Apache-2.0
//
// Case ros2: what the package agnocast_rclcpp costs and gains. A PointCloud2, from before the
// publish call to the beginning of the callback, one publisher, one subscription.
//
//   two cores       by size, pinned and real-time as in the case latency; where there is one core,
//                   on that
//   ordinary        the smallest size, not pinned and not real-time, as nodes usually run
//
// In rclcpp's executors a message takes one step more than in ours: the thread agnocast-guard
// wakes, and wakes the executor. The last table has the price of this hop, beside our own
// executor in the same round, and what remains beside rclcpp's own ways.

#include <bench/cases/ros2.hpp>

#include <bench/comparison.hpp>
#include <bench/cpus.hpp>
#include <bench/options.hpp>
#include <bench/systems/ros2.hpp>
#include <bench/wishes.hpp>

#include <algorithm>
#include <string>
#include <utility>

namespace agnocast::bench {
namespace {

constexpr std::string_view ros2_floor = "agnocast-executor", adapter = "agnocast-rclcpp";
constexpr std::size_t rounds = 7, messages = 200;

class Ros2 {
 public:
  Ros2(const Run& run, Report& report, const std::string& versions)
      : run_(run),
        wishes_(run),
        report_(report),
        pinned_(cpus().has_two() ? planned("two cores", "two-cores", Cores::two, sizes(), versions)
                                 : planned("one core", "one-core", Cores::one, sizes(), versions)),
        ordinary_(planned("ordinary scheduling", "ordinary", Cores::anywhere, {sizes().front()},
                          versions)),
        steps_(report, pinned_.steps() + ordinary_.steps()) {}

  void measure() {
    const std::vector<Comparison> by_size = measure(pinned_), ordinary = measure(ordinary_);
    steps_.finish();
    for (const Comparison& one : by_size) draw(one, pinned_);
    report_.add(lines_by_size(by_size, "ros2-by-size", "Median latency by size, " + pinned_.title));
    draw(ordinary.front(), ordinary_);
    if (ordinary.front().find(adapter) == nullptr) return;
    report_.say("\n" + std::string(adapter) +
                " beside the others: p50, us, medians over the rounds with 95 % intervals");
    Table table({"beside", "p50", "of " + std::string(adapter), "difference", "ratio"});
    for (const Comparison& one : by_size) tell_adapter(one, pinned_, table);
    tell_adapter(ordinary.front(), ordinary_, table);
    table.say(report_);
  }

 private:
  std::vector<std::size_t> sizes() const {
    return wishes_.sizes({kib, 64 * kib, mib, 8 * mib}, {kib, mib});
  }

  Measurement planned(const std::string& title, const std::string& part, Cores cores,
                      const std::vector<std::size_t>& sizes, const std::string& versions) {
    Measurement measurement{.title = title,
                            .systems = compared(),
                            .plans = {},
                            .rounds = wishes_.rounds(rounds),
                            .floor = ros2_floor,
                            .extra = {{"part", part}, {"built_with", versions}}};
    for (const std::size_t bytes : sizes)
      measurement.plans.push_back(
          wishes_.plan({.bytes = bytes, .messages = messages, .cores = cores}));
    return measurement;
  }

  std::vector<const System*> compared() const {
    std::vector<const System*> all;
    const std::vector<std::string>& named = run_.systems;
    for (const System& system : ros2::systems()) {
      if (system.name == ros2_floor || named.empty() ||
          std::find(named.begin(), named.end(), system.name) != named.end())
        all.push_back(&system);
    }
    return all;
  }

  std::vector<Comparison> measure(const Measurement& measurement) {
    return compare_and_tell(measurement, services_, steps_, report_);
  }

  static std::string part_of(const Measurement& measurement) {
    return measurement.extra.at("part").get<std::string>();
  }

  void draw(const Comparison& result, const Measurement& measurement) {
    const std::size_t bytes = result.plan.bytes;
    report_.add(Plot{
        .name = "ros2-" + part_of(measurement) + "-" + std::to_string(bytes),
        .kind = "violins",
        .title = size_text(bytes) + ", " + measurement.title + ": from publish to the callback",
        .x_label = "",
        .y_label = "microseconds",
        .log_y = true,
        .series = violins(result)});
  }

  void tell_adapter(const Comparison& result, const Measurement& measurement, Table& table) {
    const Series* const own = result.find(adapter);
    if (own == nullptr) return;
    for (const Series& other : result.series) {
      if (&other == own) continue;
      const std::vector<double> differences = own->differences_to(other),
                                ratios = own->ratios_to(other);
      const Interval apart = median_interval(differences), times = median_interval(ratios);
      const double difference = median(differences), ratio = median(ratios);
      table.add({measurement.title + ", " + size_text(result.plan.bytes) + ": " +
                     std::string(other.system->name),
                 us(other.p50_ns()), us(own->p50_ns()),
                 us(difference) + " [" + us(apart.low) + ", " + us(apart.high) + "]",
                 digits(ratio) + " [" + digits(times.low) + ", " + digits(times.high) + "]"});
      report_.add({{"part", part_of(measurement) + "-adapter"},
                   {"system", adapter},
                   {"beside", other.system->name},
                   {"size_bytes", result.plan.bytes},
                   {"difference_ns", difference},
                   {"difference_low_ns", apart.low},
                   {"difference_high_ns", apart.high},
                   {"ratio", ratio},
                   {"ratio_low", times.low},
                   {"ratio_high", times.high}});
    }
  }

  const Run& run_;
  Wishes wishes_;
  Report& report_;
  Services services_;
  const Measurement pinned_, ordinary_;
  Steps steps_;
};

}  // namespace

const std::vector<System>& ros2::systems() {
  static const std::vector<System> all = [] {
    std::vector<System> made;
    for (const System& system : bench::systems()) {
      if (system.name == ros2_floor) made.push_back(system);
    }
    for (const System& system : ros2_systems()) made.push_back(system);
    return made;
  }();
  return all;
}

void run_ros2(const Run& run, Report& report) {
  const std::string versions = ros2_versions();
  if (versions.empty()) return;
  report.say("\n" + versions);
  Ros2(run, report, versions).measure();
}

}  // namespace agnocast::bench
