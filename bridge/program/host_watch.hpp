// SPDX-License-Identifier: Apache-2.0
//
// HostWatch: what there is on this host, and whether the bridge goes on: a thread that sleeps until endpoints of this host
// change, or agnocastd is back, and then wakes the thread that has to look. Idle, it does not wake.
#pragma once

#include <agnocast/graph.hpp>
#include <bridge/common/log.hpp>

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

namespace agnocast::bridge {

class HostWatch {
 public:
  /// `log` must outlive it. `wake` is called when there is something new, or when it stops; by any thread.
  HostWatch(const Log& log, std::function<void()> wake) : log_(log), wake_(std::move(wake)) {}
  ~HostWatch();
  HostWatch(const HostWatch&) = delete;
  HostWatch& operator=(const HostWatch&) = delete;

  void start();
  /// What there is now; nothing if the last call said so already. Any thread.
  std::optional<GraphSnapshot> take_latest();

  /// Whether agnocastd answers, as a thread has heard it; said when it changes. Any thread.
  void daemon_is(bool there, const std::string& why);
  bool has_daemon() const noexcept { return daemon_ == Daemon::there; }

  /// Any thread.
  void stop() noexcept;
  bool stops() const noexcept { return stops_; }
  /// agnocastd has revoked this process, for good: only another process can go on. Stops. Any thread.
  void revoke() noexcept;
  /// Waits for the thread. Throws what it has thrown, and std::runtime_error if this process was revoked.
  void join();

 private:
  void watch();

  enum class Daemon : std::uint8_t { unknown, there, away };

  const Log& log_;
  const std::function<void()> wake_;
  Graph graph_;
  std::mutex latest_mutex_;              // of the next one
  std::optional<GraphSnapshot> latest_;  // not taken yet
  std::atomic<Daemon> daemon_{Daemon::unknown};
  std::atomic<bool> stops_{false}, is_revoked_{false};
  std::mutex pause_mutex_;
  std::condition_variable paused_;
  std::exception_ptr failed_;  // thread_, which has ended
  std::thread thread_;
};

}  // namespace agnocast::bridge
