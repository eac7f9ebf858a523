// SPDX-License-Identifier: Apache-2.0
//
// Requirements of systems beside their own processes: the installed parts of agnocast, a private
// agnocastd, and other services. Everything is in a directory of its own and ends with the
// benchmark.
#pragma once

#include <bench/process.hpp>

#include <map>
#include <memory>
#include <set>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::bench {

/// Returns the path of "agnocastd", "agnocast-ctl", "agnocast-bridge" or
/// "libagnocast_heaphook.so": beside this program if installed, else in its build tree, else
/// (programs) in PATH. Throws std::runtime_error if it is in none of them.
std::string path_of(std::string_view part);

/// A directory below $TMPDIR, readable by all users; the process that made it removes it with
/// this object.
class Directory {
 public:
  Directory();
  ~Directory();
  Directory(const Directory&) = delete;
  Directory& operator=(const Directory&) = delete;
  const std::string& path() const noexcept { return path_; }

 private:
  std::string path_;
};

/// Removes every Directory, for an end without destructors.
void remove_directories() noexcept;

/// A daemon for this run alone.
class Daemon {
 public:
  /// `config` is the text of agnocastd.toml. Returns when the daemon serves; throws with its log
  /// if it does not.
  explicit Daemon(std::string_view config = default_config);
  const std::string& socket() const noexcept { return socket_; }
  /// Returns "AGNOCAST_SOCKET=…", for the processes that use it.
  std::string variable() const { return "AGNOCAST_SOCKET=" + socket_; }
  /// Returns the supervisor; its child serves.
  Process& process() noexcept { return *process_; }
  std::string log_path() const { return directory_.path() + "/log"; }
  std::string log() const;

  static constexpr std::string_view default_config = "[daemon]\nsocket_mode = \"0666\"\n";

 private:
  Directory directory_;
  std::string socket_;
  std::unique_ptr<Process> process_;
};

/// Starts each service of System::service when it is first needed, and keeps it until its own
/// end.
class Services {
 public:
  /// Returns NAME=value for processes that use a service. "" needs nothing. Throws
  /// std::runtime_error.
  std::vector<std::string> variables(std::string_view service);
  /// Returns false, after leave_out(), if the service does not run here; then leave out systems
  /// that need it. agnocastd always runs, or this throws.
  bool has(std::string_view service);

 private:
  std::unique_ptr<Daemon> daemon_;
  Directory directory_;
  std::map<std::string, std::unique_ptr<Process>, std::less<>> others_;
  std::set<std::string, std::less<>> missing_;
};

/// Registers the start of a service other than agnocastd; once, at namespace scope, in the file
/// of its systems.
struct RegisterService {
  /// Starts it in its own `directory`. Returns when it serves, or throws std::runtime_error.
  using Start = std::unique_ptr<Process> (*)(const std::string& directory);
  RegisterService(std::string_view name, Start start);
};

}  // namespace agnocast::bench
