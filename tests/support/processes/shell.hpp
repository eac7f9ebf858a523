// SPDX-License-Identifier: Apache-2.0
//
// Commands of a shell: a line in, status and output out.
#pragma once

#include <sys/wait.h>

#include <cstdio>
#include <string>

namespace agnocast::test {

struct ShellResult {
  int status = -1;   ///< -1: it did not run, or a signal ended it
  std::string text;  ///< what it wrote to its standard output
};

/// Runs a command and waits for its end.
inline ShellResult run_in_shell(const std::string& command) {
  ShellResult result;
  std::FILE* const pipe = ::popen(command.c_str(), "re");
  if (pipe == nullptr) return result;
  char part[4096];
  while (const std::size_t count = std::fread(part, 1, sizeof part, pipe))
    result.text.append(part, count);
  const int status = ::pclose(pipe);
  if (WIFEXITED(status)) result.status = WEXITSTATUS(status);
  return result;
}

}  // namespace agnocast::test
