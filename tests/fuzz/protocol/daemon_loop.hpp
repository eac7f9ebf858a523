// SPDX-License-Identifier: Apache-2.0
//
// Daemon loop: agnocastd's broker with its listener, threads and loop, inside this process. It has
// small tables, the default quotas but for dumps, and no rule. The processes connect to it; the
// oracle sees each packet that they receive. The end of a connection and an end of a session that
// nobody asked for are judged here.
//
// Each input gets a new one.
#pragma once

#include <base/descriptors/unique_fd.hpp>
#include <base/text/log.hpp>
#include <daemon/requests/broker.hpp>

#include <tests/fuzz/protocol/oracle.hpp>
#include <tests/fuzz/protocol/processes.hpp>
#include <tests/support/machine/temporary_directory.hpp>

#include <sys/types.h>

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>

namespace agnocast::daemon::fuzz {

/// A descriptor for a packet: the window at `base`, as a daemon made it for a user.
struct BroughtWindow {
  const UniqueFd* fd = nullptr;
  std::uint64_t base = 0;
  std::uint32_t uid = 0;
};

/// Waits at its end for the threads that have begun meanwhile: a check for leaks takes what they
/// own for lost.
class ThreadsOfDaemon {
 public:
  ThreadsOfDaemon() = default;
  ThreadsOfDaemon(const ThreadsOfDaemon&) = delete;
  ThreadsOfDaemon& operator=(const ThreadsOfDaemon&) = delete;
  ~ThreadsOfDaemon();

 private:
  static nlink_t count();
  nlink_t before_ = count();
};

class DaemonLoop final {
 public:
  DaemonLoop();

  Processes& processes() { return processes_; }
  const Registry& registry() const { return broker_.registry(); }
  const AddressPlan& plan() const { return broker_.plan(); }
  Registry::Memory tables() const { return broker_.tables(); }

  /// Sends a packet of a process, on its connection or on a new one, with `fd_count` times the
  /// window; then lets the daemon do all that there is to do.
  void serve(Process& from, std::span<const std::byte> packet, std::size_t fd_count = 0,
             const BroughtWindow& brought = {});
  /// Ends its connection.
  void disconnect(Process& process);
  /// Ends the process; another may take its place.
  void die(Process& process);
  /// Sends a packet of the observer.
  void serve_observer(std::span<const std::byte> packet);
  /// Connects the observer anew.
  void connect_observer();

 private:
  [[nodiscard]] bool connect(Process& process);
  static void close(Process& process);
  void run_until_quiet();
  using Flags = std::array<bool, std::tuple_size_v<Processes>>;  // one for each process
  void judge_revocations(const Flags& were_greeted, const Flags& were_revoked);
  bool has_errands() const;
  /// Reads what the daemon has sent. Returns whether there was anything.
  bool hear();
  bool hear(Process& process);
  bool hear_observer();
  void conclude(Process& from, const Request& request, const BroughtWindow& brought);

  ThreadsOfDaemon threads_;
  test::TemporaryDirectory directory_;
  DescriptorStore store_;
  Log log_;
  Dispatcher dispatcher_;
  std::unique_ptr<Errands> errands_, closings_;
  Disposal disposal_;
  Listener listener_;
  Broker broker_;
  Processes processes_;
  Oracle oracle_{processes_};
  PacketSocket observer_;
  const Process* asks_ = nullptr;             // a process whose request is being served
  std::optional<std::uint64_t> is_revoking_;  // the client that the observer has named
  std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
};

}  // namespace agnocast::daemon::fuzz
