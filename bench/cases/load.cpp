// SPDX-License-Identifier: Apache-2.0
//
// Case load: the latency of a point cloud while the machine does other work. stress-ng keeps
// every CPU busy for a part of the time; sender and receiver are ordinary processes, not pinned
// and not real-time, and wait for the CPU like those of a robot without tuning. At each level the
// systems alternate, round by round.

#include <bench/comparison.hpp>
#include <bench/options.hpp>
#include <bench/process.hpp>

#include <csignal>
#include <memory>
#include <stdexcept>
#include <string>

namespace agnocast::bench {
namespace {

constexpr std::string_view futex_floor = "floor-futex";

bool is_ours(const System& system) { return system.name.starts_with("agnocast"); }

/// Other work for all CPUs, `percent` of the time.
class Busyness {
 public:
  /// It ends by itself after `at_most`, in case nothing else ends it.
  Busyness(unsigned percent, std::chrono::seconds at_most) {
    if (percent == 0) return;
    stress_ = std::make_unique<Process>(Process::Options{
        .command = {"stress-ng", "--quiet", "--cpu", "0", "--cpu-load", std::to_string(percent),
                    "--timeout", std::to_string(at_most.count()) + "s"},
        .end_signal = SIGTERM});
    // Waits until its processes run at a steady pace.
    if (stress_->wait(std::chrono::seconds(1)))
      throw std::runtime_error("stress-ng does not run; Debian has it in the package stress-ng");
  }
  /// Throws if it has ended meanwhile.
  void check() const {
    if (stress_ != nullptr && stress_->status())
      throw std::runtime_error("stress-ng has ended in the midst of the measurement");
  }

 private:
  std::unique_ptr<Process> stress_;
};

/// Adds an aim beside each peer of this build: systems that sleep beside those that sleep,
/// polling beside polling.
void aim_beside_peers(const Comparison& comparison, const std::string& where, Aims& aims) {
  for (const System& system : systems()) {
    if (!is_peer(system)) continue;
    const std::string name = system.is_spinning ? "agnocast-take" : "agnocast-executor";
    const std::string aim = where + ", p99: " + name + " / " + std::string(system.name);
    const Series *const own = comparison.find(name), *const peer = comparison.find(system.name);
    if (own != nullptr && peer != nullptr) {
      aims.add(aim, own->p99_ratio_to(*peer), Aims::Sense::at_most, 1,
               own->p99_ratio_interval(*peer), basis_of(comparison, Basis::enough_for_p99));
    } else {
      aims.add(aim, {}, Aims::Sense::at_most, 1);
    }
  }
}

std::vector<const System*> systems_of(const Run& run, Services& services) {
  std::vector<std::string_view> names;
  for (const System& system : systems()) {
    if (!run.systems.empty() || is_ours(system) || is_peer(system)) names.push_back(system.name);
  }
  return chosen(run, names, futex_floor, services);
}

/// A judged p99 needs many samples: 42 of 4,200 are beyond it.
Plan plan_of(const Run& run, std::size_t bytes, bool is_judged) {
  using std::chrono::milliseconds;
  const std::chrono::nanoseconds period = run.period.value_or(milliseconds(run.is_small ? 1 : 10));
  Plan plan{.bytes = bytes, .cores = Cores::anywhere};
  plan.messages = run.messages.value_or(run.is_small ? 10 : is_judged ? 600 : 150);
  plan.warm_up = run.is_small ? 2 : 10;
  plan.period_ns = period.count();
  return plan;
}

}  // namespace

void run_load(const Run& run, Report& report) {
  const std::vector<unsigned> levels =
      run.is_small ? std::vector<unsigned>{0, 90} : std::vector<unsigned>{0, 30, 60, 90};
  const std::vector<std::size_t> sizes =
      run.sizes.empty() ? std::vector<std::size_t>{100 * 1024} : run.sizes;
  const std::size_t rounds = run.rounds.value_or(run.is_small ? 1 : 7);
  Services services;
  const std::vector<const System*> all = systems_of(run, services);
  Aims aims(run);
  Steps steps(report, sizes.size() * levels.size() * rounds * all.size());
  for (const std::size_t bytes : sizes) {
    for (const unsigned level : levels) {
      const bool is_judged = level == levels.back();
      const Plan plan = plan_of(run, bytes, is_judged);
      const std::string where = size_text(bytes) + ", load " + std::to_string(level) + " %";
      const Busyness busyness(level, longest_of(plan) * static_cast<int>(rounds * all.size() + 1));
      const auto step = [&](const System& system, const Plan&) {
        busyness.check();
        steps.next(where + ", " + std::string(system.name));
      };
      const Comparison result = compare(all, {plan}, rounds, services, step).front();
      busyness.check();
      report.say("\n" + where + ", every " + digits(static_cast<double>(plan.period_ns) / 1e6) +
                 " ms, " + std::to_string(rounds) + " x " + std::to_string(plan.messages) +
                 " messages");
      tell(result, futex_floor, {{"load_percent", level}}, report);
      report.add(Plot{.name = "load-" + std::to_string(level) + "-" + std::to_string(bytes),
                      .kind = "violins",
                      .title = where + ": from publish to the message in hand",
                      .x_label = "",
                      .y_label = "microseconds",
                      .log_y = true,
                      .series = violins(result)});
      if (is_judged) aim_beside_peers(result, where, aims);
    }
  }
  steps.finish();
  aims.tell(report);
}

}  // namespace agnocast::bench
