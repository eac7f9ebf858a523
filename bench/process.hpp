// SPDX-License-Identifier: Apache-2.0
//
// Process: a program started by the benchmark, which never outlives it. Role: the function of a
// process of the benchmark's own binary, by name.
//
//   agnocast-bench %NAME ARGUMENTS…      runs a role; only for Process, not for users
//
// A case with processes of its own registers their roles at namespace scope:
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
    std::vector<std::string> command;           ///< searched in PATH unless it has a slash
    std::vector<std::string> environment = {};  ///< NAME=value, in addition to the caller's
    std::vector<int> descriptors = {};          ///< inherited under the same numbers; no others are
    std::string output = {};     ///< file for both streams, appended; empty: the caller's
    bool has_pipes = false;      ///< send() and line() use its input and output
    int end_signal = 9;          ///< sent by the destructor, and by the kernel at our death
    void (*at_end)() = nullptr;  ///< called after its end, to remove leftovers
  };
  /// Throws std::system_error if no process can be made; a missing program appears as status 127.
  /// The process dies with the thread that calls this.
  explicit Process(Options options);
  /// end(end_signal), if it still runs.
  ~Process();
  Process(Process&& other) noexcept;
  Process& operator=(Process&&) = delete;

  pid_t pid() const noexcept { return pid_; }
  /// Returns its exit status, 128 + N after signal N; empty while it runs.
  std::optional<int> status();
  /// Waits; returns empty when the time is up.
  std::optional<int> wait(std::chrono::milliseconds at_most);
  /// Sends `signal` and waits; sends SIGKILL after ten seconds. Returns its status.
  int end(int signal);
  /// Sends SIGKILL, and waits.
  void kill() { (void)end(9); }

  /// Does the work of all destructors, for an end without any. Processes ended by SIGKILL go
  /// first, because a daemon releases the resources of its clients, and waits for living ones.
  /// After it, Process is unusable: every call blocks.
  static void end_all() noexcept;

  /// With pipes: writes a line to its standard input. Returns false if it reads no more and the
  /// caller ignores SIGPIPE.
  bool send(std::string_view line);
  /// With pipes: returns the next line of its standard output. Throws if it has ended, or after
  /// `at_most`; on a busy machine not before it has computed for that long, or does nothing.
  std::string line(std::chrono::milliseconds at_most = std::chrono::seconds(60));

 private:
  pid_t pid_ = -1;
  int input_ = -1, output_ = -1;
  int end_signal_ = 9;
  void (*at_end_)() = nullptr;
  std::optional<int> status_;
  std::string name_, buffer_;
};

/// Returns the command of this very program in a role.
std::vector<std::string> as_role(std::string_view role, std::vector<std::string> arguments = {});

using RoleMain = int (*)(const std::vector<std::string>& arguments);
/// Registers a role; one object at namespace scope for each.
struct RegisterRole {
  RegisterRole(std::string_view name, RoleMain main);
};
/// Returns null if there is no such role.
RoleMain find_role(std::string_view name);
/// Runs a role in this process, which gets its name. Returns its exit status; 2 if there is no
/// such role.
int run_role(const std::string& name, const std::vector<std::string>& arguments);

}  // namespace agnocast::bench
