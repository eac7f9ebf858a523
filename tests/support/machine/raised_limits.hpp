// SPDX-License-Identifier: Apache-2.0
//
// The right to raise hard limits, of this or of another process.
#pragma once

#include <fstream>
#include <string>

namespace agnocast::test {

/// Returns whether the test may raise hard limits. Root in a container may not.
inline bool may_raise_limits() {
  constexpr unsigned cap_sys_resource = 24;
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.rfind("CapEff:", 0) == 0)
      return (std::stoull(line.substr(7), nullptr, 16) >> cap_sys_resource & 1) != 0;
  }
  return false;
}

}  // namespace agnocast::test
