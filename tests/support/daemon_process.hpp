// SPDX-License-Identifier: Apache-2.0
//
// DaemonProcess: the real agnocastd in a directory of its own, for integration tests.
//
//   DaemonProcess daemon;                          // or DaemonProcess daemon({.config =
//   "[quota]\n…"}); … connect to daemon.socket_path() … EXPECT_EQ(daemon.stop(), 0); // or let the
//   destructor kill it
//
// The constructor returns when the daemon serves (it says so through NOTIFY_SOCKET, so nothing is
// polled); if it ends instead or says nothing, the test fails with what it wrote. The daemon dies
// with the test process.
//
// As users start it, it is two processes: the supervisor that the test starts, and the worker, which
// is the daemon; pid(), memory and descriptors are the worker's. kill() ends both at once, as a power
// failure would; kill_worker() ends the daemon alone, and another one goes on. Target: link agnocast_test_support, which knows where agnocastd is.
#pragma once

#include <base/unique_fd.hpp>

#include <sys/types.h>

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

namespace agnocast::test {

/// For [heap] of every configuration whose clients run under a sanitizer: with ThreadSanitizer they
/// have shadows where the arena is by default, and not in the first 512 GiB.
#if defined(__SANITIZE_THREAD__)
#define AGNOCAST_TEST_ARENA_BASE "arena_base = \"64GiB\"\n"
#else
#define AGNOCAST_TEST_ARENA_BASE ""
#endif

struct DaemonOptions {
  /// Text of the configuration; empty: small windows, everything else by default.
  std::string config = {};
  /// Behind that text.
  std::string more_config = {};
  /// Run as this user and group (the test must be root).
  std::optional<uid_t> uid = {};
  std::vector<std::string> arguments = {};
  /// Where to listen; empty: in its own directory.
  std::string socket = {};
  /// The program, another one than the build's.
  std::string program = {};
  /// As on a kernel before 6.5: SO_PEERPIDFD is not known (a seccomp filter answers).
  bool without_peer_pidfd = false;
  /// As on a kernel before 6.16: SO_PASSRIGHTS is not known, so clients may send descriptors.
  bool without_passrights = false;
  /// NAME=value, beside the test's own.
  std::vector<std::string> environment = {};
  /// Passed to it under the name that it knows, as by a socket unit; they stay the test's.
  std::vector<int> sockets = {};
};

class DaemonProcess {
 public:
  explicit DaemonProcess(DaemonOptions options = {});
  ~DaemonProcess();
  DaemonProcess(const DaemonProcess&) = delete;
  DaemonProcess& operator=(const DaemonProcess&) = delete;

  const std::string& socket_path() const noexcept { return socket_path_; }
  /// Of this daemon alone, removed with it; everybody may look into it.
  const std::string& directory() const noexcept { return directory_; }
  /// The daemon's; another one after each restart.
  pid_t pid() const { return worker_of(pid_); }
  /// Of the process that the test started, which keeps the descriptors; the daemon's own with
  /// --fd-store=none.
  pid_t supervisor_pid() const noexcept { return pid_; }

  /// SIGTERM (or another signal) and its exit status; -1 when a signal ended it.
  int stop(int signal = 0);
  /// SIGKILL to the supervisor, and waits until the daemon is gone as well.
  void kill();
  /// SIGKILL to the daemon alone (or another signal to it); its pid. Does not wait for the next one.
  pid_t kill_worker(int signal = 9);
  /// Waits until a daemon serves that is not `old`; false after ten seconds.
  [[nodiscard]] bool wait_for_next(pid_t old) const;
  bool is_running();

  /// What it wrote to stderr so far.
  std::string log() const;
  /// Waits until the log holds `text`; false after ten seconds.
  [[nodiscard]] bool wait_for_log(const std::string& text) const;
  /// Entries of /proc/PID/fd.
  std::size_t descriptor_count() const;
  /// Of the supervisor: what is kept, and a few of its own.
  std::size_t kept_count() const;
  /// Resident memory in bytes.
  std::size_t resident_bytes() const;
  /// Of it, what lies in memfds: tables, board and regions.
  std::size_t shared_bytes() const;

 private:
  void begin(const DaemonOptions& options);
  static pid_t worker_of(pid_t pid);

  std::string directory_;
  std::string socket_path_;
  pid_t pid_ = -1;
};

/// Runs agnocastd to its end with these arguments: for everything that ends at once.
struct Ended {
  int status = -1;  // exit status; -1: ended by a signal, or still running after ten seconds
  std::string out;
  std::string err;
};
Ended run_daemon(const std::vector<std::string>& arguments, std::optional<uid_t> uid = {},
                 const std::vector<std::string>& environment = {},
                 const std::vector<int>& sockets = {});

/// A new directory under $TMPDIR (or /tmp), mode 0755. The caller removes it.
std::string make_directory();
void remove_directory(const std::string& path);

/// Runs `condition` again and again until it holds; false after ten seconds. Only for what cannot
/// be waited for otherwise (states of other processes).
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
