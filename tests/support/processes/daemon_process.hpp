// SPDX-License-Identifier: Apache-2.0
//
// DaemonProcess: the real agnocastd in its own directory, for integration tests.
//
//   DaemonProcess daemon;           // or DaemonProcess daemon({.config = "[quota]\n…"});
//   … connect to daemon.socket_path() …
//   EXPECT_EQ(daemon.stop(), 0);    // or let the destructor kill it
//
// The constructor returns when the daemon serves (it reports that through NOTIFY_SOCKET, without
// polling); if it ends or reports nothing, the test fails with its output. The daemon dies with
// the test process.
//
// As users start it, it is two processes: the supervisor that the test starts, and the worker,
// which is the daemon; pid(), memory and descriptors are the worker's. kill() ends both at once,
// like a power failure; kill_worker() ends only the daemon, and another one resumes. Link
// agnocast_test_support, which knows the path of agnocastd.
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <sys/types.h>

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

namespace agnocast::test {

/// For [heap] in every configuration whose clients run under a sanitizer: ThreadSanitizer has its
/// shadow memory at the default arena, but not in the first 512 GiB.
#if defined(AGNOCAST_UNDER_THREAD_SANITIZER)
#define AGNOCAST_TEST_ARENA_BASE "arena_base = \"64GiB\"\n"
#else
#define AGNOCAST_TEST_ARENA_BASE ""
#endif

struct DaemonOptions {
  /// Text of the configuration; empty: small windows, all else default.
  std::string config = {};
  /// Appended to that text.
  std::string more_config = {};
  /// Keys of its table [daemon] for the default configuration.
  std::string more_daemon_config = {};
  /// Run as this user and group (the test must be root).
  std::optional<uid_t> uid = {};
  std::vector<std::string> arguments = {};
  /// Where to listen; empty: in its own directory.
  std::string socket = {};
  /// Another program than the build's.
  std::string program = {};
  /// As on a kernel before 6.5: SO_PEERPIDFD is unknown (a seccomp filter answers).
  bool without_peer_pidfd = false;
  /// As on a kernel before 6.16: SO_PASSRIGHTS is unknown, so clients may send descriptors.
  bool without_passrights = false;
  /// NAME=value, beside the test's own.
  std::vector<std::string> environment = {};
  /// Passed under the name that the daemon expects, as by a socket unit; the test keeps them too.
  std::vector<int> sockets = {};
};

class DaemonProcess {
 public:
  explicit DaemonProcess(DaemonOptions options = {});
  ~DaemonProcess();
  DaemonProcess(const DaemonProcess&) = delete;
  DaemonProcess& operator=(const DaemonProcess&) = delete;

  const std::string& socket_path() const noexcept { return socket_path_; }
  /// For this daemon only, removed with it; readable for all users.
  const std::string& directory() const noexcept { return directory_; }
  /// Returns the daemon's pid; another one after each restart.
  pid_t pid() const { return worker_of(pid_); }
  /// Returns the pid of the process that the test started, which keeps the descriptors; with
  /// --fd-store=none it is the daemon itself.
  pid_t supervisor_pid() const noexcept { return pid_; }

  /// Sends SIGTERM (or another signal). Returns the exit status, or -1 if a signal ended it.
  int stop(int signal = 0);
  /// Kills the supervisor with SIGKILL, and waits until the daemon is gone as well.
  void kill();
  /// Kills only the daemon (or sends `signal`). Returns its pid; does not wait for the next one.
  pid_t kill_worker(int signal = 9);
  /// Waits until another daemon than `old` serves; false after a minute.
  [[nodiscard]] bool wait_for_next(pid_t old) const;
  bool is_running();

  /// Returns what it has written to stderr so far.
  std::string log() const;
  /// Waits until the log contains `text`; false after a minute.
  [[nodiscard]] bool wait_for_log(const std::string& text) const;
  /// Returns the number of entries of /proc/PID/fd.
  std::size_t descriptor_count() const;
  /// Returns the supervisor's descriptors: the kept ones, and a few of its own.
  std::size_t kept_count() const;
  /// Returns the resident memory in bytes.
  std::size_t resident_bytes() const;
  /// Returns the part of it in memfds: tables, board and regions.
  std::size_t shared_bytes() const;

 private:
  void begin(const DaemonOptions& options);
  static pid_t worker_of(pid_t pid);

  std::string directory_;
  std::string socket_path_;
  pid_t pid_ = -1;
};

/// Runs agnocastd with these arguments until it ends: for runs that end at once.
struct Ended {
  int status = -1;  // exit status; -1: ended by a signal, or still running after a minute
  std::string out;
  std::string err;
};
Ended run_daemon(const std::vector<std::string>& arguments, std::optional<uid_t> uid = {},
                 const std::vector<std::string>& environment = {},
                 const std::vector<int>& sockets = {});

/// Makes a directory under $TMPDIR (or /tmp), mode 0755. The caller removes it.
std::string make_directory();
void remove_directory(const std::string& path);

/// Runs `condition` repeatedly until it holds; false after a minute. Only for conditions that
/// the test cannot wait for otherwise (states of other processes).
template <class Condition>
[[nodiscard]] bool eventually(Condition condition);

namespace detail {
void pause_briefly();
bool time_is_up(unsigned rounds);
}  // namespace detail

template <class Condition>
bool eventually(Condition condition) {
  for (unsigned rounds = 0; !detail::time_is_up(rounds); ++rounds) {
    if (condition()) return true;
    detail::pause_briefly();
  }
  return condition();
}

}  // namespace agnocast::test
