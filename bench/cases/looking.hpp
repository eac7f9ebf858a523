// SPDX-License-Identifier: Apache-2.0
//
// Observations of processes from outside: memory, processor time.
#pragma once

#include <bench/services.hpp>

#include <sys/types.h>
#include <time.h>

#include <cstdarg>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace agnocast::bench {

/// Returns a figure of /proc/…, "RssShmem" of a status or "MemAvailable" of meminfo, in bytes; 0
/// if there is none.
inline std::size_t bytes_in(const std::string& file, const std::string& field) {
  std::ifstream stream(file);
  for (std::string word; stream >> word;) {
    std::size_t count = 0;  // of KiB
    if (word == field + ":" && stream >> count) return count * 1024;
  }
  return 0;
}

inline std::string status_of(pid_t pid) { return "/proc/" + std::to_string(pid) + "/status"; }

inline std::size_t resident_bytes(pid_t pid) { return bytes_in(status_of(pid), "VmRSS"); }
/// Returns its resident bytes in memfds.
inline std::size_t shared_bytes(pid_t pid) { return bytes_in(status_of(pid), "RssShmem"); }
inline std::size_t available_bytes() { return bytes_in("/proc/meminfo", "MemAvailable"); }

/// Returns the processor time of all its threads so far.
inline double cpu_ns_of(pid_t pid) {
  clockid_t clock{};
  timespec time{};
  if (::clock_getcpuclockid(pid, &clock) != 0 || ::clock_gettime(clock, &time) != 0)
    throw std::runtime_error("process " + std::to_string(pid) + " has ended unexpectedly");
  return static_cast<double>(time.tv_sec) * 1e9 + static_cast<double>(time.tv_nsec);
}

/// Returns the serving process: the child of the started supervisor.
inline pid_t worker_of(Daemon& daemon) {
  const std::string supervisor = std::to_string(daemon.process().pid());
  std::ifstream children("/proc/" + supervisor + "/task/" + supervisor + "/children");
  pid_t child = -1;
  if (!(children >> child))
    throw std::runtime_error("agnocastd has ended; it wrote:\n" + daemon.log());
  return child;
}

/// Returns the environment of publishing processes.
inline std::vector<std::string> variables_of(const Daemon& daemon) {
  return {daemon.variable(), "LD_PRELOAD=" + path_of("libagnocast_heaphook.so")};
}

/// printf into a string, for lines of tables.
[[gnu::format(printf, 1, 2)]] inline std::string text(const char* form, ...) {
  std::va_list values, again;
  va_start(values, form);
  va_copy(again, values);
  std::string line(static_cast<std::size_t>(std::vsnprintf(nullptr, 0, form, values)), '\0');
  std::vsnprintf(line.data(), line.size() + 1, form, again);
  va_end(again);
  va_end(values);
  return line;
}

}  // namespace agnocast::bench
