// SPDX-License-Identifier: Apache-2.0
//
// Case rmw: unchanged rclcpp nodes over several rmws. A PointCloud2, from before the publish call
// to the beginning of the callback, one publisher.
//
//   by size         one subscription, pinned and real-time as in the case latency; where there is
//                   one core, on that
//   by subscribers  1 MB, until the slowest has it
//
// The nodes publish(const T&) and take copies. Those of rclcpp-agnocast-loans fill a message that
// they borrowed, and rclcpp takes loans: ROS_DISABLE_LOANED_MESSAGES=0.

#include <bench/cases/rmw.hpp>

#include <bench/comparison.hpp>
#include <bench/cpus.hpp>
#include <bench/options.hpp>
#include <bench/systems/ros2.hpp>
#include <bench/wishes.hpp>

#include <algorithm>
#include <string>
#include <vector>

namespace agnocast::bench {
namespace {

constexpr std::string_view usual = "rclcpp-cyclonedds";
constexpr std::size_t rounds = 7, messages = 200;
// What unchanged nodes and nodes with loans are to be faster than they are over Cyclone DDS.
constexpr double times_unchanged = 6, times_with_loans = 30;

class Rmw {
 public:
  Rmw(const Run& run, Report& report, const std::string& versions)
      : run_(run),
        wishes_(run),
        report_(report),
        by_size_(planned("one subscription", "by-size", versions,
                         wishes_.sizes({kib, 64 * kib, mib, 8 * mib}, {kib, mib}), 1)),
        by_subscribers_(planned_by_subscribers(versions)),
        steps_(report, by_size_.steps() + by_subscribers_.size() * by_subscribers_[0].steps()),
        aims_(run) {}

  void measure() {
    const std::vector<Comparison> sizes = compare_and_tell(by_size_, services_, steps_, report_);
    std::vector<Comparison> crowds;
    for (const Measurement& one : by_subscribers_)
      crowds.push_back(compare_and_tell(one, services_, steps_, report_).front());
    steps_.finish();
    report_.add(lines_by_size(sizes, "rmw-by-size", "Median latency by size, unchanged nodes"));
    draw(crowds);
    for (const Comparison& one : sizes) {
      if (one.plan.bytes != mib) continue;
      judge(one, "rclcpp-agnocast", "unchanged nodes", times_unchanged);
      judge(one, "rclcpp-agnocast-loans", "nodes with loans", times_with_loans);
    }
    aims_.tell(report_);
  }

 private:
  Measurement planned(const std::string& title, const std::string& part,
                      const std::string& versions, const std::vector<std::size_t>& sizes,
                      std::size_t receivers) const {
    Measurement measurement{.title = title,
                            .systems = compared(),
                            .plans = {},
                            .rounds = wishes_.rounds(rounds),
                            .floor = usual,
                            .extra = {{"part", part}, {"built_with", versions}}};
    for (const std::size_t bytes : sizes)
      measurement.plans.push_back(
          wishes_.plan({.bytes = bytes,
                        .receivers = receivers,
                        .messages = messages,
                        .period_ns = 5'000'000,
                        .cores = cpus().has_two() ? Cores::two : Cores::one}));
    return measurement;
  }

  std::vector<Measurement> planned_by_subscribers(const std::string& versions) const {
    const std::vector<std::size_t> all = {2, 4, 8}, few = {2};
    std::vector<Measurement> by_count;
    for (const std::size_t count : wishes_.is_small() ? few : all)
      by_count.push_back(planned(std::to_string(count) + " subscriptions", "by-subscribers",
                                 versions, {mib}, count));
    return by_count;
  }

  std::vector<const System*> compared() const {
    std::vector<const System*> all;
    const std::vector<std::string>& named = run_.systems;
    for (const System& system : rmw::systems()) {
      const bool is_named = std::find(named.begin(), named.end(), system.name) != named.end();
      if (system.name == usual || named.empty() || is_named) all.push_back(&system);
    }
    return all;
  }

  void judge(const Comparison& one, const std::string& system, const std::string& how,
             double times) {
    const Series *const ours = one.find(system), *const theirs = one.find(usual);
    aims_.add_median(
        how + ", 1 MB: time over " + std::string(usual) + " / over agnocast",
        ours == nullptr || theirs == nullptr ? std::vector<double>() : theirs->ratios_to(*ours),
        Aims::Sense::at_least, times, basis_of(one));
  }

  void draw(const std::vector<Comparison>& crowds) {
    Plot plot{.name = "rmw-by-subscribers",
              .kind = "lines",
              .title = "1 MB: until the slowest of several subscriptions has it, median",
              .x_label = "subscriptions",
              .y_label = "microseconds",
              .log_y = true};
    for (const System* const system : by_size_.systems) {
      nlohmann::json x = nlohmann::json::array(), y = nlohmann::json::array();
      for (const Comparison& one : crowds) {
        const Series* const found = one.find(system->name);
        if (found == nullptr) continue;
        x.push_back(one.plan.receivers);
        y.push_back(found->p50_ns() / 1000);
      }
      if (!x.empty()) plot.series.push_back({{"label", system->name}, {"x", x}, {"y", y}});
    }
    report_.add(std::move(plot));
  }

  const Run& run_;
  Wishes wishes_;
  Report& report_;
  Services services_;
  const Measurement by_size_;
  const std::vector<Measurement> by_subscribers_;
  Steps steps_;
  Aims aims_;
};

}  // namespace

const std::vector<System>& rmw::systems() {
  static const std::vector<System> all = rmw_systems();
  return all;
}

void run_rmw(const Run& run, Report& report) {
  const std::string versions = ros2_versions();
  if (versions.empty()) return;
  report.say("\n" + versions);
  Rmw(run, report, versions).measure();
}

}  // namespace agnocast::bench
