// SPDX-License-Identifier: Apache-2.0
//
// Case latency: from before the publish call to the message in the receiver's hand, one sender,
// one receiver.
//
//   one core        every system that sleeps. Both processes on one CPU, so a wake-up is a switch
//                   and nothing else; across cores it is mostly the interrupt and the halted CPU,
//                   which all systems share and which hide their differences. This compares ways
//                   to notify.
//   two cores       every system, by size: does the time depend on the size?
//   bare calls      publish with no sleeping receiver, take and release (latency_bare.cpp)
//   across users    the receiver as another user, which gets a datagram instead of an eventfd

#include <bench/cases/latency_bare.hpp>
#include <bench/comparison.hpp>
#include <bench/cpus.hpp>
#include <bench/environment.hpp>
#include <bench/figures.hpp>
#include <bench/options.hpp>
#include <bench/wishes.hpp>

#include <unistd.h>

#include <algorithm>
#include <optional>
#include <string>
#include <tuple>
#include <utility>

namespace agnocast::bench {
namespace {

constexpr std::string_view floor_name = "floor-futex", ours = "agnocast-executor",
                           spinning = "agnocast-spinning", taking = "agnocast-take";
constexpr std::uint32_t nobody = 65534;
constexpr std::size_t rounds = 7;
constexpr double quotient_bound = 1.10;

class Latency {
 public:
  Latency(const Run& run, Report& report)
      : run_(run),
        wishes_(run),
        report_(report),
        one_core_(planned_on_one_core()),
        two_cores_(planned_on_two_cores()),
        across_users_(planned_across_users()),
        steps_(report, one_core_.steps() + two_cores_.steps() + across_users_.steps() +
                           wishes_.rounds(rounds)),
        aims_(run) {}

  void one_core() {
    for (const Comparison& result : measure(one_core_)) {
      const std::size_t bytes = result.plan.bytes;
      draw(result, "latency-one-core-" + std::to_string(bytes),
           "One core, " + size_text(bytes) + ": from publish to the message in hand");
      const std::string where = "one core, " + size_text(bytes) + ": ";
      aim_ratio(result, ours, floor_name, where, 1.25);
      aim_ratio(result, ours, "iceoryx-listener", where, 1);
      aim_ratio(result, ours, "bound-kernel-module", where, 1);
    }
  }

  void two_cores() {
    std::vector<Comparison> by_size;
    if (cpus().has_two()) {
      by_size = measure(two_cores_);
    } else {
      leave_out("latency on two cores is left out: there is one");
    }
    for (const Comparison& result : by_size) {
      const std::size_t bytes = result.plan.bytes;
      draw(result, "latency-two-cores-" + std::to_string(bytes),
           "Two cores, " + size_text(bytes) + ": from publish to the message in hand");
    }
    aim_beside_peers(of_size(by_size, mib));
    const Comparison smallest = of_size(by_size, kib);
    const std::string where = "two cores, 1 KiB: ";
    aim_ratio(smallest, spinning, "floor-polling", where, 1.5);
    aims_.add_information(text_of(where, spinning, "floor-chain"),
                          ratios(smallest, spinning, "floor-chain"));
    tell_quotients(by_size);
    if (!by_size.empty())
      report_.add(lines_by_size(by_size, "latency-by-size", "Two cores: median latency by size"));
  }

  void bare_calls() {
    const BareCalls measured =
        measure_bare_calls(wishes_.rounds(rounds), wishes_.is_small() ? 160 : 100000, services_,
                           [this] { steps_.next("bare calls"); });
    report_.say(
        "\nbare calls, no sleeping receiver, 1 KiB: one thread, warm, both ends in one process,"
        " in batches of eight");
    Table table({"call", "ns", "x (mutex + clock)"});
    table.add({"mutex lock and unlock, one clock read", digits(measured.mutex_clock_ns), "1"});
    for (const BareCall& call : measured.calls) {
      table.add({call.name, digits(median(call.ns)), digits(median(call.ratios))});
      report_.add({{"part", "bare-calls"},
                   {"call", call.name},
                   {"system", "agnocast"},
                   {"size_bytes", kib},
                   {"p50_ns", median(call.ns)},
                   {"ratio_to_mutex_and_clock", median(call.ratios)}});
      const std::string aim = std::string(call.name) + " / (mutex + clock)";
      if (call.is_judged) {
        aims_.add_median(aim, call.ratios, Aims::Sense::at_most, 3);
      } else {
        aims_.add_information(aim, call.ratios);
      }
    }
    table.say(report_);
  }

  void across_users() {
    const std::string where = "across users, one core, 1 KiB: ";
    if (::geteuid() != 0) {
      leave_out("latency across users is left out: only root can start a receiver as another user");
      return aim_ratio({}, ours, floor_name, where, 2);
    }
    aim_ratio(measure(across_users_).front(), ours, floor_name, where, 2);
  }

  void tell_aims() {
    steps_.finish();
    aims_.tell(report_);
  }

 private:
  Measurement planned(const std::string& title, const std::string& part,
                      std::vector<const System*> systems, const std::vector<std::size_t>& sizes,
                      Plan plan) {
    Measurement measurement{.title = title,
                            .systems = std::move(systems),
                            .plans = {},
                            .rounds = wishes_.rounds(rounds),
                            .floor = floor_name,
                            .extra = {{"part", part}}};
    for (const std::size_t bytes : sizes) {
      plan.bytes = bytes;
      measurement.plans.push_back(wishes_.plan(plan));
    }
    return measurement;
  }
  Measurement planned_on_one_core() {
    std::vector<const System*> systems = chosen(run_, all_names(), floor_name, services_);
    std::erase_if(systems, [](const System* one) { return one->is_spinning; });
    return planned("one core", "one-core", std::move(systems),
                   wishes_.sizes({kib, 100 * kib}, {kib}), {.messages = 1000, .cores = Cores::one});
  }
  Measurement planned_on_two_cores() {
    if (!cpus().has_two()) return {};
    return planned("two cores", "two-cores", chosen(run_, all_names(), floor_name, services_),
                   wishes_.sizes({kib, 10 * kib, 100 * kib, mib, 8 * mib}, {kib, mib}),
                   {.messages = 400, .cores = Cores::two});
  }
  Measurement planned_across_users() {
    if (::geteuid() != 0) return {};
    return planned("one core, receiver of another user", "across-users",
                   chosen(run_, {ours}, floor_name, services_), {kib},
                   {.cores = Cores::one, .receiver_uid = nobody});
  }
  std::vector<Comparison> measure(const Measurement& measurement) {
    return compare_and_tell(measurement, services_, steps_, report_);
  }

  void draw(const Comparison& result, const std::string& name, const std::string& title) {
    report_.add(Plot{.name = name,
                     .kind = "violins",
                     .title = title,
                     .x_label = "",
                     .y_label = "microseconds",
                     .log_y = true,
                     .series = violins(result)});
  }

  /// Returns the comparison of a size; empty if it was not measured.
  static Comparison of_size(const std::vector<Comparison>& by_size, std::size_t bytes) {
    for (const Comparison& one : by_size) {
      if (one.plan.bytes == bytes) return one;
    }
    return {};
  }
  /// Returns one ratio per round; none if one of the systems took no part.
  static std::vector<double> ratios(const Comparison& result, std::string_view system,
                                    std::string_view base) {
    const Series *const one = result.find(system), *const other = result.find(base);
    if (one == nullptr || other == nullptr) return {};
    return one->ratios_to(*other);
  }
  static std::string text_of(const std::string& where, std::string_view system,
                             std::string_view base) {
    return where + std::string(system) + " / " + std::string(base);
  }

  void aim_ratio(const Comparison& result, std::string_view system, std::string_view base,
                 const std::string& where, double bound) {
    aims_.add_median(text_of(where, system, base), ratios(result, system, base),
                     Aims::Sense::at_most, bound, basis_of(result));
  }

  // Compares like with like: systems that sleep, and systems that poll.
  void aim_beside_peers(const Comparison& result) {
    const std::string where = "two cores, 1 MiB: ";
    for (const auto& [peer, own, bound] : {std::tuple("cyclonedds", ours, 40.0),
                                           {"cyclonedds-tuned", ours, 0.0},
                                           {"cyclonedds-iceoryx", ours, 4.0},
                                           {"iceoryx-listener", ours, 1.0},
                                           {"iceoryx-waitset", ours, 1.0},
                                           {"iceoryx-polling", taking, 1.0}}) {
      const std::string text = text_of(where, peer, own);
      const std::vector<double> of_rounds = ratios(result, peer, own);
      // The aim is for Cyclone DDS with its defaults.
      if (bound == 0) {
        aims_.add_information(text, of_rounds);
      } else {
        aims_.add_median(text, of_rounds, Aims::Sense::at_least, bound, basis_of(result));
      }
    }
  }

  // Prints how much longer the largest size takes than the smallest, relative to the floor in the
  // same round: cache effects occur in the floor too.
  void tell_quotients(const std::vector<Comparison>& by_size) {
    const std::string aim = "size quotient of " + std::string(ours) + " / the floor's";
    if (by_size.empty() || by_size.front().plan.bytes >= by_size.back().plan.bytes)
      return aims_.add(aim, {}, Aims::Sense::at_most, quotient_bound);
    const Comparison &smallest = by_size.front(), &largest = by_size.back();
    const auto quotients_of = [&](std::string_view name) {
      return largest.find(name)->ratios_to(*smallest.find(name));
    };
    const std::vector<double> floors = quotients_of(floor_name);
    std::vector<double> of_ours;
    const std::string sizes =
        size_text(largest.plan.bytes) + " / " + size_text(smallest.plan.bytes);
    report_.say("\nsize: p50 of " + sizes);
    Table table({"system", "quotient", "x floor's quotient"});
    for (const Series& one : largest.series) {
      const std::vector<double> quotients = quotients_of(one.system->name);
      std::vector<double> over_floors;
      for (std::size_t i = 0; i < std::min(quotients.size(), floors.size()); ++i)
        over_floors.push_back(quotients[i] / floors[i]);
      const double quotient = median(quotients), over_floor = median(over_floors);
      table.add({std::string(one.system->name), digits(quotient), digits(over_floor)});
      report_.add({{"part", "size-quotient"},
                   {"system", one.system->name},
                   {"size_bytes", largest.plan.bytes},
                   {"smallest_size_bytes", smallest.plan.bytes},
                   {"quotient", quotient},
                   {"quotient_to_floor", over_floor},
                   {"floor", floor_name}});
      if (one.system->name == ours) of_ours = over_floors;
    }
    table.say(report_);
    aims_.add_median(aim + ", " + sizes, of_ours, Aims::Sense::at_most, quotient_bound,
                     basis_of(largest));
  }

  const Run& run_;
  Wishes wishes_;
  Report& report_;
  Services services_;
  const Measurement one_core_, two_cores_, across_users_;
  Steps steps_;
  Aims aims_;
};

}  // namespace

void run_latency(const Run& run, Report& report) {
  Latency latency(run, report);
  latency.one_core();
  latency.two_cores();
  latency.bare_calls();
  latency.across_users();
  latency.tell_aims();
}

}  // namespace agnocast::bench
