// SPDX-License-Identifier: Apache-2.0

#include <bench/environment.hpp>

#include <agnocast/version.hpp>
#include <bench/cpus.hpp>
#include <bench/system.hpp>

#include <sched.h>
#include <sys/utsname.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <optional>

namespace agnocast::bench {
namespace {

std::optional<std::string> line_of(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  if (!std::getline(file, line)) return {};
  return line;
}

std::optional<std::string> cpu_model() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    const std::size_t colon = line.find(": ");
    if (line.starts_with("model name") && colon != std::string::npos) return line.substr(colon + 2);
  }
  return {};
}

// Returns "madvise" for "always [madvise] never".
std::optional<std::string> chosen_of(const std::string& path) {
  const auto line = line_of(path);
  if (!line) return {};
  const std::size_t begin = line->find('['), end = line->find(']');
  if (begin == std::string::npos || end == std::string::npos) return line;
  return line->substr(begin + 1, end - begin - 1);
}

std::optional<std::int64_t> number_of(const std::string& path) {
  std::ifstream file(path);
  std::int64_t number = 0;
  if (!(file >> number)) return {};
  return number;
}

std::optional<std::int64_t> memory_bytes() {
  const std::int64_t pages = ::sysconf(_SC_PHYS_PAGES), page = ::sysconf(_SC_PAGESIZE);
  if (pages <= 0 || page <= 0) return {};
  return pages * page;
}

void keep_cpus(nlohmann::json& all) {
  all["cores"] = cpus().usable.size();
  all["cpus"] = {cpus().first};
  if (cpus().has_two()) all["cpus"].push_back(cpus().second);
  if (cpus().are_siblings) all["cpus_are_siblings"] = *cpus().are_siblings;
}

void keep_load(nlohmann::json& all, const char* key) {
  double load[3];
  if (::getloadavg(load, 3) == 3) all[key] = load;
}

// Tries it in a child: this process must stay as it is.
bool may_be_realtime() {
  const pid_t pid = ::fork();
  if (pid == 0) {
    sched_param priority{};
    priority.sched_priority = 51;
    ::_exit(::sched_setscheduler(0, SCHED_FIFO, &priority) == 0 ? 0 : 1);
  }
  int status = 1;
  return pid > 0 && ::waitpid(pid, &status, 0) == pid && status == 0;
}

std::string now_text() {
  const std::time_t now = std::time(nullptr);
  std::tm parts{};
  ::gmtime_r(&now, &parts);
  char text[32];
  std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &parts);
  return text;
}

nlohmann::json build() {
  return {{"version", std::to_string(AGNOCAST_VERSION_MAJOR) + "." +
                          std::to_string(AGNOCAST_VERSION_MINOR) + "." +
                          std::to_string(AGNOCAST_VERSION_PATCH)},
          {"revision", revision},
          {"compiler", AGNOCAST_BENCH_COMPILER},
          {"build_type", AGNOCAST_BENCH_BUILD_TYPE},
          {"cyclonedds", AGNOCAST_BENCH_CYCLONEDDS},
          {"iceoryx", AGNOCAST_BENCH_ICEORYX}};
}

std::vector<std::string>& left_out_here() {
  static std::vector<std::string> all;
  return all;
}

}  // namespace

void leave_out(const std::string& what) {
  std::vector<std::string>& all = left_out_here();
  if (std::find(all.begin(), all.end(), what) != all.end()) return;
  std::fprintf(stderr, "note: %s\n", what.c_str());
  all.push_back(what);
}

nlohmann::json environment(const std::vector<std::string>& arguments) {
  nlohmann::json all = build();
  all["arguments"] = arguments;
  for (const char* const optional : {"revision", "cyclonedds", "iceoryx"}) {
    if (all[optional] == "") all.erase(optional);
  }
  const auto keep = [&all](const char* key, const std::optional<std::string>& value) {
    if (value) all[key] = *value;
  };
  const auto keep_number = [&all](const char* key, std::optional<std::int64_t> value) {
    if (value) all[key] = *value;
  };
  all["time"] = now_text();
  keep_cpus(all);
  keep("cpu", cpu_model());
  utsname system{};
  if (::uname(&system) == 0) {
    all["kernel"] = system.release;
    all["machine"] = system.machine;
  }
  const std::string cpu = "/sys/devices/system/";
  keep("smt", line_of(cpu + "cpu/smt/control"));
  keep("governor", line_of(cpu + "cpu/cpu0/cpufreq/scaling_governor"));
  keep("clock_source", line_of(cpu + "clocksource/clocksource0/current_clocksource"));
  const std::string huge = "/sys/kernel/mm/transparent_hugepage/";
  keep("huge_pages", chosen_of(huge + "enabled"));
  keep("shared_huge_pages", chosen_of(huge + "shmem_enabled"));
  keep_number("memory_bytes", memory_bytes());
  keep_number("rmem_max_bytes", number_of("/proc/sys/net/core/rmem_max"));
  keep_number("sched_rt_runtime_us", number_of("/proc/sys/kernel/sched_rt_runtime_us"));
  keep_load(all, "load");
  all["realtime"] = may_be_realtime();
  all["root"] = ::geteuid() == 0;
  all["absent"] = absent();
  return all;
}

void complete(nlohmann::json& environment) {
  keep_load(environment, "load_end");
  environment["left_out"] = left_out_here();
}

std::vector<std::string> doubts(const nlohmann::json& environment) {
  std::vector<std::string> all = absent();
  if (environment.at("build_type") != "Release")
    all.emplace_back("this program was not built as Release: its figures have little meaning");
  if (!environment.at("realtime").get<bool>())
    all.emplace_back(
        "SCHED_FIFO is not permitted: tails are longer, and on one core the order of processes is "
        "the scheduler's");
  if (environment.at("cores").get<unsigned>() < 2)
    all.emplace_back("there is one core: what needs two is left out");
  if (environment.value("cpus_are_siblings", false))
    all.emplace_back("the two CPUs are threads of one core, and slow each other down");
  if (environment.contains("load") &&
      environment["load"][0].get<double>() > 0.5 * environment.at("cores").get<double>())
    all.emplace_back("the machine is busy: compare ratios only");
  return all;
}

}  // namespace agnocast::bench
