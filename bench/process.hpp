// SPDX-License-Identifier: Apache-2.0
//
// Process: a program that the benchmark starts, and that never outlives it. Role: what a process of the benchmark's own
// binary does, by name.
//
//   agnocast-bench %NAME ARGUMENTS…      as a role; for Process alone, not for people
//
// A case that needs processes of its own registers what they do at namespace scope:
//
//   const RegisterRole dying("death-publisher", [](const std::vector<std::string>& arguments) { … return 0; });
//   Process process({.command = as_role("death-publisher", {"argument"})});
#pragma once

#include <sys/types.h>

#include <chrono>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::bench {

class Process {
 public:
  struct Options {
    std::vector<std::string> command;           ///< looked for in PATH unless it has a slash
    std::vector<std::string> environment = {};  ///< NAME=value, beside the caller's own
    std::vector<int> descriptors = {};  ///< inherited under the same numbers; nothing else is
    std::string output = {};            ///< file for both streams, appended; empty: the caller's
    bool has_pipes = false;             ///< its standard input and output are send() and line()
    int end_signal = 9;                 ///< what the destructor sends, and the kernel when we die
    void (*at_end)() = nullptr;         ///< after its end, for what it may have left
  };
  /// Throws std::system_error when there is no process; that the program is missing shows as status 127. It dies with
  /// the thread that calls this.
  explicit Process(Options options);
  /// end(end_signal), if it still runs.
  ~Process();
  Process(Process&& other) noexcept;
  Process& operator=(Process&&) = delete;

  pid_t pid() const noexcept { return pid_; }
  /// Its exit status, 128 + N after signal N; empty while it runs.
  std::optional<int> status();
  /// Waits; empty when the time is up.
  std::optional<int> wait(std::chrono::milliseconds at_most);
  /// Sends `signal` and waits; SIGKILL after ten seconds. Its status.
  int end(int signal);
  /// SIGKILL, and waits.
  void kill() { (void)end(9); }

  /// What the destructors of all of them would do: for who ends without any. Those who die of SIGKILL come first, as a daemon
  /// gives back what its clients had, and waits for those who live. From then on Process is of no use: whoever uses it blocks.
  static void end_all() noexcept;

  /// With pipes: a line to its standard input. False when it reads no more, to a caller who ignores SIGPIPE.
  bool send(std::string_view line);
  /// With pipes: the next line of its standard output. Throws when it ended, or after `at_most`.
  std::string line(std::chrono::milliseconds at_most = std::chrono::seconds(60));

 private:
  pid_t pid_ = -1;
  int input_ = -1, output_ = -1;
  int end_signal_ = 9;
  void (*at_end_)() = nullptr;
  std::optional<int> status_;
  std::string name_, buffer_;
};

/// Of this very program, as a role.
std::vector<std::string> as_role(std::string_view role, std::vector<std::string> arguments = {});

using RoleMain = int (*)(const std::vector<std::string>& arguments);
/// One object of it at namespace scope for each role.
struct RegisterRole {
  RegisterRole(std::string_view name, RoleMain main);
};
/// Null: there is no such role.
RoleMain find_role(std::string_view name);

}  // namespace agnocast::bench
