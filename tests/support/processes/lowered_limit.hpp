// SPDX-License-Identifier: Apache-2.0
//
// LoweredLimit: a running process that may not have more of something, for a while.
#pragma once

#include <gtest/gtest.h>

#include <sys/resource.h>
#include <sys/types.h>

#include <cstdint>
#include <fstream>
#include <string>

namespace agnocast::test {

/// Lowers a soft limit (RLIMIT_*, getrlimit(2)) of a process as long as this lives.
class LoweredLimit {
 public:
  LoweredLimit(pid_t pid, __rlimit_resource resource, rlim_t value)
      : pid_(pid), resource_(resource) {
    EXPECT_EQ(::prlimit(pid, resource, nullptr, &before_), 0);
    const rlimit lowered{value, before_.rlim_max};
    EXPECT_EQ(::prlimit(pid, resource, &lowered, nullptr), 0);
  }
  ~LoweredLimit() { lift(); }
  LoweredLimit(const LoweredLimit&) = delete;
  LoweredLimit& operator=(const LoweredLimit&) = delete;

  /// Gives the process the limit that it had.
  void lift() { EXPECT_EQ(::prlimit(pid_, resource_, &before_, nullptr), 0); }

 private:
  pid_t pid_;
  __rlimit_resource resource_;
  rlimit before_{};
};

/// Returns the bytes that a process has of what RLIMIT_DATA limits: VmData, proc_pid_status(5).
inline std::uint64_t data_bytes(pid_t pid) {
  std::ifstream status("/proc/" + std::to_string(pid) + "/status");
  for (std::string line; std::getline(status, line);)
    if (line.starts_with("VmData:")) return std::stoull(line.substr(7)) * 1024;
  ADD_FAILURE() << "process " << pid << " does not say what data it has";
  return 0;
}

}  // namespace agnocast::test
