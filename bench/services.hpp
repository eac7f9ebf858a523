// SPDX-License-Identifier: Apache-2.0
//
// What systems need beside their own processes: where the parts of agnocast are, a private agnocastd, and whatever else
// has to run first. Everything lives in a directory of its own and ends with the benchmark.
#pragma once

#include <bench/process.hpp>

#include <map>
#include <memory>
#include <set>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::bench {

/// "agnocastd", "agnocast-ctl", "agnocast-bridge", "libagnocast_heaphook.so": beside this program as it is installed, else
/// in the tree that built it, else (programs) in PATH. Throws std::runtime_error when it is nowhere.
std::string path_of(std::string_view part);

/// A directory below $TMPDIR, which everybody may look into; removed with this, by the process that made it.
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

/// Removes every Directory that there is: for who ends without destructors.
void remove_directories() noexcept;

/// A daemon for this run alone.
class Daemon {
 public:
  /// `config` is the text of agnocastd.toml. Returns when it serves; throws with its log when it does not.
  explicit Daemon(std::string_view config = default_config);
  const std::string& socket() const noexcept { return socket_; }
  /// "AGNOCAST_SOCKET=…", for those who are to find it.
  std::string variable() const { return "AGNOCAST_SOCKET=" + socket_; }
  /// Of the supervisor; what serves is its child.
  Process& process() noexcept { return *process_; }
  std::string log_path() const { return directory_.path() + "/log"; }
  std::string log() const;

  static constexpr std::string_view default_config = "[daemon]\nsocket_mode = \"0666\"\n";

 private:
  Directory directory_;
  std::string socket_;
  std::unique_ptr<Process> process_;
};

/// Starts each service of System::service when it is asked for first, and keeps it to its own end.
class Services {
 public:
  /// NAME=value for processes that use it. "" needs nothing. Throws std::runtime_error.
  std::vector<std::string> variables(std::string_view service);
  /// False: it does not run here, which leave_out() has been told; what needs it is to be left out. There is always an agnocastd,
  /// or this throws.
  bool has(std::string_view service);

 private:
  std::unique_ptr<Daemon> daemon_;
  Directory directory_;
  std::map<std::string, std::unique_ptr<Process>, std::less<>> others_;
  std::set<std::string, std::less<>> missing_;
};

/// How a service other than agnocastd is started, by whoever owns the systems that need it; once, at namespace scope.
struct RegisterService {
  /// In `directory`, which is the service's own. Returns when it serves, or throws std::runtime_error.
  using Start = std::unique_ptr<Process> (*)(const std::string& directory);
  RegisterService(std::string_view name, Start start);
};

}  // namespace agnocast::bench
