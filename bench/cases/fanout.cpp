// SPDX-License-Identifier: Apache-2.0
//
// Case fanout: one sender, 1 to 16 receivers. Measures the cost of the publish call for each
// further one, and when the last one has the message. The sender is on one core, all receivers
// are on the other, one after the other.
//
//   asleep  every receiver must be woken: the publish call beside as many bare futex wakes. The
//           call itself wakes two of agnocast's, and leaves the others, and the reclamation scan,
//           to the control thread of its process: so the table also has the processor time of the
//           whole sender and the time until the last one has the message
//   awake   none must be woken: the publish call beside the one with a single receiver. Receivers
//           that never sleep share their core by time slices, so the arrival time at the last one
//           depends on the scheduler; table and plot note that. One of them runs at a time: the
//           call meets one reader at once, which favours systems with a cache line for each
//           reader

#include <bench/comparison.hpp>
#include <bench/cpus.hpp>
#include <bench/environment.hpp>
#include <bench/options.hpp>
#include <bench/wishes.hpp>

#include <map>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::bench {
namespace {

constexpr double asleep_bound = 1, awake_bound = 8;

class Fanout {
 public:
  Fanout(const Run& run, Report& report)
      : run_(run),
        wishes_(run),
        report_(report),
        counts_(run.is_small ? std::vector<std::size_t>{1, 4}
                             : std::vector<std::size_t>{1, 2, 4, 8, 16}),
        asleep_(planned("asleep", false, "floor-futex", 200)),
        awake_(planned("awake", true, "floor-polling", 100)),
        steps_(report, counts_.size() * (asleep_.front().steps() + awake_.front().steps())),
        aims_(run) {}

  void asleep() {
    const auto by_count = measure("asleep", asleep_);
    const Comparison& most = by_count.back();
    const Series *const ours = most.find("agnocast-executor"), &floor = *most.find("floor-futex");
    const std::string where =
        text_of_size() + " to " + std::to_string(counts_.back()) + " sleeping subscribers";
    const auto of_ours = [&](std::vector<double> (Series::*ratios)(const Series&) const) {
      return ours == nullptr ? std::vector<double>() : (ours->*ratios)(floor);
    };
    aims_.add_median("publish of " + where + ", the call / as many bare futex wakes",
                     of_ours(&Series::publish_ratios_to), Aims::Sense::at_most, asleep_bound,
                     basis_of(most));
    aims_.add_information(where + ", processor time of the sender / of the floor's",
                          of_ours(&Series::sender_cpu_ratios_to));
    aims_.add_information(where + ", until the slowest has it / the floor's",
                          of_ours(&Series::ratios_to));
    report_.say(
        "  agnocast's call wakes two receivers; the control thread of its process wakes the others "
        "and frees old messages:\n  the sender's CPU and the time of the slowest include that");
  }

  void awake() {
    const auto by_count = measure("awake", awake_, ", alternating on one core");
    report_.say(
        "  receivers that never sleep share a core by time slices: the time of the slowest depends "
        "on the "
        "scheduler,\n  the time of the publish call on the system, with one reader at a "
        "time");
    for (const std::string name : {"agnocast-spinning", "agnocast-take"}) {
      const Series *const most = by_count.back().find(name), *const one =
                                                                 by_count.front().find(name);
      aims_.add_median(
          name + ": publish of " + text_of_size() + " to " + std::to_string(counts_.back()) +
              " awake / to one awake",
          most == nullptr || one == nullptr ? std::vector<double>() : most->publish_ratios_to(*one),
          Aims::Sense::at_most, awake_bound, basis_of(by_count.back()));
    }
  }

  void tell_aims() {
    steps_.finish();
    aims_.tell(report_);
  }

 private:
  std::string text_of_size() const { return size_text(asleep_.front().plans.front().bytes); }
  /// Returns one measurement for each number of receivers.
  std::vector<Measurement> planned(const std::string& part, bool are_spinning,
                                   std::string_view floor, std::size_t messages) {
    std::vector<const System*> systems = chosen(run_, all_names(), floor, services_);
    std::erase_if(systems, [&](const System* one) {
      return one->is_spinning != are_spinning || one->name == "floor-memcpy";
    });
    std::vector<Measurement> by_count;
    for (const std::size_t count : counts_) {
      const Plan plan = wishes_.plan({.bytes = wishes_.sizes({100 * kib}, {kib}).front(),
                                      .receivers = count,
                                      .messages = messages,
                                      .period_ns = 5'000'000,
                                      .cores = Cores::two});
      by_count.push_back(
          {.title = part + ", " + std::to_string(count) + (count == 1 ? " receiver" : " receivers"),
           .systems = systems,
           .plans = {plan},
           .rounds = wishes_.rounds(7),
           .floor = floor,
           .extra = {{"part", part}}});
    }
    return by_count;
  }

  std::vector<Comparison> measure(const std::string& part,
                                  const std::vector<Measurement>& measurements,
                                  const std::string& how = "") {
    std::vector<Comparison> by_count;
    for (const Measurement& one : measurements)
      by_count.push_back(compare_and_tell(one, services_, steps_, report_).front());
    tell_publish(part, by_count);
    draw(part + ": the publish call", "fanout-publish-" + part, by_count,
         [](const Series& one) { return one.publish_of_eight_ns(); });
    draw(part + how + ": until the slowest has it", "fanout-slowest-" + part, by_count,
         [](const Series& one) { return one.p50_ns(); });
    return by_count;
  }

  void tell_publish(const std::string& part, const std::vector<Comparison>& by_count) {
    report_.say("\n" + part + ": publish call, mean of eight in a row, median, us, by receivers");
    std::vector<std::string> head{"system"};
    for (const std::size_t count : counts_) head.push_back(std::to_string(count));
    Table table(head);
    for (const Series& first : by_count.front().series) {
      std::vector<std::string> row{std::string(first.system->name)};
      for (const Comparison& one : by_count) {
        const Series* const series = one.find(first.system->name);
        row.push_back(series == nullptr ? "-" : us(series->publish_of_eight_ns()));
      }
      table.add(row);
    }
    table.say(report_);
  }

  template <class Of>
  void draw(const std::string& title, const std::string& name,
            const std::vector<Comparison>& by_count, Of of) {
    Plot plot{.name = name,
              .kind = "lines",
              .title = "Receivers " + title,
              .x_label = "receivers",
              .y_label = "microseconds, median",
              .log_x = true,
              .log_y = true};
    for (const Series& first : by_count.front().series) {
      nlohmann::json line = {{"label", first.system->name}};
      for (const Comparison& one : by_count) {
        const Series* const series = one.find(first.system->name);
        if (series == nullptr) continue;
        line["x"].push_back(one.plan.receivers);
        line["y"].push_back(of(*series) / 1000);
      }
      plot.series.push_back(std::move(line));
    }
    report_.add(std::move(plot));
  }

  const Run& run_;
  Wishes wishes_;
  Report& report_;
  const std::vector<std::size_t> counts_;
  Services services_;
  const std::vector<Measurement> asleep_, awake_;
  Steps steps_;
  Aims aims_;
};

}  // namespace

void run_fanout(const Run& run, Report& report) {
  if (!cpus().has_two()) {
    leave_out("fanout is left out: it needs two cores");
    Aims aims(run);
    aims.add("publish to 16 sleeping subscribers, the call / as many bare futex wakes", {},
             Aims::Sense::at_most, asleep_bound);
    aims.add("publish to 16 awake / to one awake", {}, Aims::Sense::at_most, awake_bound);
    return aims.tell(report);
  }
  Fanout fanout(run, report);
  fanout.asleep();
  fanout.awake();
  fanout.tell_aims();
}

}  // namespace agnocast::bench
