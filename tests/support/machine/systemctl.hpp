// SPDX-License-Identifier: Apache-2.0
//
// Units of a systemd, as a user sees them, for programs that run inside of systemd_machine.sh.
#pragma once

#include <tests/support/processes/shell.hpp>

#include <sys/types.h>

#include <cstdlib>
#include <string>

namespace agnocast::test {

/// Runs a command in a shell. Returns what it wrote, without newlines at the end.
inline std::string output_of(const std::string& command) {
  std::string text = run_in_shell(command).text;
  while (!text.empty() && text.back() == '\n') text.pop_back();
  return text;
}
inline std::string property_of(const std::string& unit, const std::string& name) {
  return output_of("systemctl show --value -p " + name + ' ' + unit);
}
/// Returns whether systemctl succeeded; an empty unit for verbs without one.
inline bool run_systemctl(const std::string& verb, const std::string& unit) {
  return std::system(("systemctl " + verb + ' ' + unit + " 2>&1").c_str()) == 0;
}
inline pid_t main_pid_of(const std::string& unit) {
  return static_cast<pid_t>(std::atoi(property_of(unit, "MainPID").c_str()));
}

}  // namespace agnocast::test
