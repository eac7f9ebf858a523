// SPDX-License-Identifier: Apache-2.0
//
// A program started by the demo: lines to its standard input, lines from its standard output. It
// dies with the demo in any case (PR_SET_PDEATHSIG), and with this object.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

namespace demo {

/// Ends the demo early; the text is for the user.
struct Failure : std::runtime_error {
  using std::runtime_error::runtime_error;
};
/// SIGINT, SIGTERM or SIGHUP arrived.
struct Interrupted {
  int signal;
};

/// From now on these signals end the demo through Interrupted, so that it can clean up.
void catch_signals();
/// Throws Interrupted if one arrived. Every waiting function here calls it.
void check_signals();

class Process {
 public:
  struct Options {
    std::string name;  // in failures
    std::vector<std::string> command;
    std::map<std::string, std::string> environment = {};  // beyond the demo's own
    int descriptor_3 = -1;                                // becomes descriptor 3, if given
    std::string error_file = {};                          // standard error; empty: the demo's
  };
  explicit Process(Options options);
  ~Process();
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  pid_t pid() const noexcept { return pid_; }
  const std::string& name() const noexcept { return options_.name; }
  void send(const std::string& line);
  void close_input();
  /// Returns the next line. Throws Failure if the process has ended or is silent for a minute.
  std::string line();
  /// Returns the exit status; 128 + N after signal N. Waits a minute at most.
  int wait();
  /// Returns whether it has ended.
  bool has_ended();

 private:
  Options options_;
  pid_t pid_ = -1;
  int input_ = -1;
  int output_ = -1;
  std::string buffer_;
  std::optional<int> status_;
};

}  // namespace demo
