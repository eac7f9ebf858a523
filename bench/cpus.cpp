// SPDX-License-Identifier: Apache-2.0

#include <bench/cpus.hpp>

#include <sched.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <stdexcept>
#include <utility>

namespace agnocast::bench {
namespace {

std::vector<int> usable_cpus() {
  cpu_set_t set;
  CPU_ZERO(&set);
  if (::sched_getaffinity(0, sizeof set, &set) != 0)
    throw std::runtime_error(std::string("which CPUs may be used: ") + std::strerror(errno));
  std::vector<int> all;
  for (std::size_t cpu = 0; cpu < CPU_SETSIZE; ++cpu) {
    if (CPU_ISSET(cpu, &set)) all.push_back(static_cast<int>(cpu));
  }
  return all;
}

// Returns "0,4" or "0-1", the same for all threads of a core.
std::optional<std::string> core_in_sys(int cpu) {
  std::ifstream file("/sys/devices/system/cpu/cpu" + std::to_string(cpu) +
                     "/topology/thread_siblings_list");
  std::string threads;
  if (!std::getline(file, threads)) return {};
  return threads;
}

}  // namespace

Cpus choose_cpus(std::vector<int> usable,
                 const std::function<std::optional<std::string>(int cpu)>& core_of) {
  Cpus cpus;
  cpus.usable = std::move(usable);
  cpus.first = cpus.second = cpus.usable.at(0);
  if (cpus.usable.size() < 2) return cpus;
  const auto core = core_of(cpus.first);
  const auto other = std::find_if(cpus.usable.begin() + 1, cpus.usable.end(), [&](int cpu) {
    const auto its_core = core_of(cpu);
    return core && its_core && *its_core != *core;
  });
  cpus.second = other == cpus.usable.end() ? cpus.usable[1] : *other;
  if (core && core_of(cpus.second)) cpus.are_siblings = other == cpus.usable.end();
  return cpus;
}

const Cpus& cpus() {
  static const Cpus all = choose_cpus(usable_cpus(), core_in_sys);
  return all;
}

bool pin_to(int cpu) noexcept {
  cpu_set_t set;
  CPU_ZERO(&set);
  CPU_SET(static_cast<std::size_t>(cpu), &set);
  return ::sched_setaffinity(0, sizeof set, &set) == 0;
}

}  // namespace agnocast::bench
