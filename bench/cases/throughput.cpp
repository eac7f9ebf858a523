// SPDX-License-Identifier: Apache-2.0
//
// Throughput: messages of 64 bytes per second, and bytes per second in messages of 1 MiB, back to
// back from one sender to one and to four receivers, on one core and on two. The result includes
// the whole cost of a message: borrowing, writing each byte, sending, waking, taking, reading
// each byte, releasing.
//
// Queues are alike in all systems and nothing may be lost: see throughput_roles.cpp. All
// processes have ordinary scheduling; the kernel would stop a real-time sender that never waits
// from time to time.

#include <bench/cases/throughput.hpp>
#include <bench/comparison.hpp>
#include <bench/cpus.hpp>
#include <bench/environment.hpp>
#include <bench/figures.hpp>
#include <bench/options.hpp>

#include <unistd.h>

#include <algorithm>
#include <map>
#include <set>
#include <stdexcept>
#include <string>

namespace agnocast::bench {
namespace throughput {

const std::vector<System>& systems() {
  static const std::vector<System> all = [] {
    std::vector<System> made = ring_systems();
    for (const System& system : agnocast_systems()) made.push_back(system);
    for (const System& system : bench::systems()) {
      if (system.name.starts_with("iceoryx") || system.name.starts_with("cyclonedds"))
        made.push_back(system);
    }
    return made;
  }();
  return all;
}

const System& find(std::string_view name) {
  for (const System& system : systems()) {
    if (system.name == name) return system;
  }
  throw std::runtime_error("throughput: no such system: " + std::string(name));
}

namespace {

constexpr std::string_view rate_floor = "floor-futex";
constexpr double aim = 3;  // times the comparable system of iceoryx

/// One table: all systems under the same conditions.
struct Setting {
  Cores cores;
  std::size_t receivers;
  std::size_t bytes;

  std::size_t core_count() const { return cores == Cores::one ? 1 : 2; }
  bool is_small() const { return bytes == small_bytes; }
  bool is_possible() const { return cores == Cores::one || cpus().has_two(); }
  std::string text() const {
    return "1:" + std::to_string(receivers) + (core_count() == 1 ? ", one core" : ", two cores");
  }
  /// Returns whether there are enough cores: a receiver that never sleeps keeps others from
  /// running.
  bool has_room_for(const System& system) const {
    return !system.is_spinning || core_count() > receivers;
  }
};

std::vector<Setting> settings(const Run& run) {
  std::vector<std::size_t> sizes = run.sizes;
  if (sizes.empty()) sizes = {small_bytes, large_bytes};
  std::vector<Setting> all;
  for (const std::size_t bytes : sizes) {
    for (const Cores cores : {Cores::one, Cores::two}) {
      for (const std::size_t receivers : {1UL, 4UL}) {
        // A test runs each size, and each number of cores and receivers once.
        if (!run.is_small || (cores == Cores::two) == (receivers == 1))
          all.push_back({cores, receivers, bytes});
      }
    }
  }
  return all;
}

Plan plan_of(const Setting& setting, const Run& run) {
  Plan plan{.bytes = setting.bytes, .receivers = setting.receivers, .messages = 1};
  plan.warm_up = run.is_small ? 20 : setting.is_small() ? 5000 : 100;
  plan.cores = setting.cores;
  plan.is_real_time = false;
  plan.depth = setting.is_small() ? 100 : 10;  // 10 of 1 MiB exceed most caches
  plan.lasting_ns = run.is_small ? 20'000'000 : 300'000'000;
  return plan;
}

/// Returns messages per second.
double rate_of(const System& system, const Plan& plan, Services& services) {
  static unsigned run_count = 0;
  Lane lane(plan, system.name,
            "/bench/p" + std::to_string(::getpid()) + "/throughput" + std::to_string(++run_count));
  conduct_roles(system, lane, services, sender_role, receiver_role);
  const Lane::Sent& span = lane.sent(1);
  const auto messages = static_cast<double>(lane.seen(0).number.load() - plan.warm_up);
  return messages * 1e9 / static_cast<double>(span.end_ns - span.begin_ns);
}

using Rates = std::map<std::string_view, std::vector<double>>;  // per round

/// Returns the ratios within each round.
std::vector<double> ratios(const std::vector<double>& rates, const std::vector<double>& base) {
  std::vector<double> ratios;
  for (std::size_t round = 0; round < std::min(rates.size(), base.size()); ++round)
    ratios.push_back(rates[round] / base[round]);
  return ratios;
}

void tell(const Setting& setting, const Rates& rates, Report& report) {
  const auto bytes = static_cast<double>(setting.bytes);
  const auto floor = rates.find(rate_floor);
  Table table({"system", "messages/s", "MB/s", "CV", "x " + std::string(rate_floor)});
  for (const System& system : systems()) {
    const auto found = rates.find(system.name);
    if (found == rates.end()) continue;
    const std::vector<double>& own = found->second;
    const double rate = median(own);
    nlohmann::json result = {
        {"system", system.name},       {"cores", setting.core_count()},
        {"size_bytes", setting.bytes}, {"receivers", setting.receivers},
        {"rounds", own.size()},        {"messages_per_second", rate},
        {"variation", variation(own)}, {"bytes_per_second", rate * bytes},
    };
    if (floor != rates.end()) {
      result["ratio_to_floor"] = median(ratios(own, floor->second));
      result["floor"] = rate_floor;
    }
    table.add({std::string(system.name), digits(rate), digits(rate * bytes / 1e6),
               digits(variation(own)),
               floor == rates.end() ? "" : digits(median(ratios(own, floor->second)))});
    report.add(std::move(result));
  }
  table.say(report);
}

/// Returns the fastest of these; empty if none of them took part.
std::string_view fastest(const Rates& rates, const std::vector<std::string_view>& names) {
  std::string_view best;
  for (const std::string_view name : names) {
    const auto one = rates.find(name);
    if (one != rates.end() &&
        (best.empty() || median(one->second) > median(rates.find(best)->second)))
      best = name;
  }
  return best;
}

/// Returns nothing if one of them took no part.
std::vector<double> ratios(const Rates& rates, std::string_view system, std::string_view base) {
  const auto one = rates.find(system), other = rates.find(base);
  if (one == rates.end() || other == rates.end()) return {};
  return ratios(one->second, other->second);
}

/// Compares like with like: systems that sleep with each other, one message per call with one
/// message per call. Large messages have no aim, because all systems are as fast as memory.
void aim_beside_iceoryx(const Setting& setting, const Rates& rates, Aims& aims) {
  if (!setting.is_small()) return;
  const std::string where = setting.text() + ", messages a second: ";
  const std::string_view sleeping = fastest(rates, {"iceoryx-listener", "iceoryx-waitset"});
  aims.add_median(where + "agnocast-executor / " +
                      (sleeping.empty() ? "the better of iceoryx-listener and -waitset"
                                        : std::string(sleeping)),
                  ratios(rates, "agnocast-executor", sleeping), Aims::Sense::at_least, aim);
  if (setting.core_count() <= setting.receivers) return;  // no system polls there
  aims.add_median(where + "agnocast-take / iceoryx-polling",
                  ratios(rates, "agnocast-take", "iceoryx-polling"), Aims::Sense::at_least, aim);
  aims.add_information(where + "agnocast-batch, 16 a call / iceoryx-polling, one a call",
                       ratios(rates, "agnocast-batch", "iceoryx-polling"));
}

/// Returns the requested systems whose services run here.
std::vector<const System*> chosen(const Run& run, Services& services) {
  std::vector<const System*> all;
  for (const System& system : systems()) {
    const bool is_wanted =
        run.systems.empty() || system.name == rate_floor ||
        std::find(run.systems.begin(), run.systems.end(), system.name) != run.systems.end();
    if (is_wanted && services.has(system.service)) all.push_back(&system);
  }
  return all;
}

/// One plot for all settings of a size.
struct Picture {
  std::vector<std::string> groups;
  std::map<std::string_view, std::vector<double>> heights;

  void add(const Setting& setting, const Rates& rates) {
    groups.push_back(setting.text());
    const double unit = setting.is_small() ? 1e-6 : static_cast<double>(setting.bytes) * 1e-9;
    for (const System& system : systems()) {
      const auto rate = rates.find(system.name);
      heights[system.name].push_back(rate == rates.end() ? 0 : median(rate->second) * unit);
    }
  }
  void draw(bool is_small, Report& report) const {
    Plot plot{.name = is_small ? "throughput-messages" : "throughput-bytes",
              .kind = "bars",
              .title = is_small ? "Messages of 64 bytes" : "Messages of 1 MiB",
              .x_label = "sender : receivers",
              .y_label = is_small ? "million messages a second" : "GB a second",
              .log_y = true,
              .groups = groups};
    for (const System& system : systems()) {
      const std::vector<double>& own = heights.at(system.name);
      if (std::any_of(own.begin(), own.end(), [](double height) { return height > 0; }))
        plot.series.push_back({{"label", system.name}, {"y", own}});
    }
    report.add(std::move(plot));
  }
};

}  // namespace
}  // namespace throughput

void run_throughput(const Run& run, Report& report) {
  using namespace throughput;
  Services services;
  Aims aims(run);
  const std::vector<const System*> all = throughput::chosen(run, services);
  const std::vector<Setting> tables = settings(run);
  const std::size_t rounds = run.rounds.value_or(run.is_small ? 1 : 7);
  std::map<bool, Picture> pictures;
  std::size_t steps = 0;
  for (const Setting& setting : tables) {
    if (!setting.is_possible()) continue;
    for (const System* const system : all) steps += setting.has_room_for(*system) ? rounds : 0;
  }
  Steps on_the_way(report, steps);
  for (const Setting& setting : tables) {
    if (!setting.is_possible()) {
      leave_out("throughput on two cores is left out: there is one");
      aim_beside_iceoryx(setting, {}, aims);
      continue;
    }
    const Plan plan = plan_of(setting, run);
    const std::string where = setting.text() + ", messages of " + size_text(setting.bytes);
    Rates rates;
    std::set<const System*> failed;
    for (std::size_t round = 0; round < rounds; ++round) {
      for (std::size_t turn = 0; turn < all.size(); ++turn) {
        const System* const system = all[(round + turn) % all.size()];
        if (!setting.has_room_for(*system)) continue;
        if (failed.count(system) != 0) continue;
        on_the_way.next(where + ", " + std::string(system->name));
        const bool is_done = takes_its_turn(
            *system, [&] { rates[system->name].push_back(rate_of(*system, plan, services)); });
        if (!is_done) failed.insert(system);
      }
    }
    for (const System* const system : failed) rates.erase(system->name);
    report.say("\n" + where + ", at most " + std::to_string(plan.depth) + " unread, " +
               std::to_string(rounds) + " x " + std::to_string(plan.lasting_ns / 1'000'000) +
               " ms");
    throughput::tell(setting, rates, report);
    aim_beside_iceoryx(setting, rates, aims);
    pictures[setting.is_small()].add(setting, rates);
  }
  on_the_way.finish();
  if (std::none_of(tables.begin(), tables.end(), [](const Setting& one) { return one.is_small(); }))
    aims.add("messages of 64 bytes a second: agnocast / iceoryx", {}, Aims::Sense::at_least, aim);
  for (const auto& [is_small, picture] : pictures) picture.draw(is_small, report);
  aims.tell(report);
}

}  // namespace agnocast::bench
