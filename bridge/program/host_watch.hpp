// SPDX-License-Identifier: Apache-2.0
//
// HostWatch: the endpoints of this host, and whether the bridge may continue. A thread sleeps
// until endpoints of this host change or agnocastd is back, and then wakes run(). While nothing
// happens, it does not wake.
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
  /// `log` must outlive it. `wake` is called by any thread when something is new or it stops.
  HostWatch(const Log& log, std::function<void()> wake) : log_(log), wake_(std::move(wake)) {}
  ~HostWatch();
  HostWatch(const HostWatch&) = delete;
  HostWatch& operator=(const HostWatch&) = delete;

  void start();
  /// Returns the newest snapshot; nothing if the last call returned it already. Any thread.
  std::optional<GraphSnapshot> take_latest();

  /// Records whether agnocastd answers, as a thread noticed it; logs a change. Any thread.
  void daemon_is(bool there, const std::string& why);
  bool has_daemon() const noexcept { return daemon_ == Daemon::there; }

  /// Any thread.
  void stop() noexcept;
  bool stops() const noexcept { return stops_; }
  /// Stops: agnocastd has revoked this process, so only a new one can continue. Any thread.
  void revoke() noexcept;
  /// Waits for the thread. Throws its exception, or std::runtime_error after a revocation.
  void join();

 private:
  void watch();

  enum class Daemon : std::uint8_t { unknown, there, away };

  const Log& log_;
  const std::function<void()> wake_;
  Graph graph_;
  std::mutex latest_mutex_;              // guards latest_
  std::optional<GraphSnapshot> latest_;  // not taken yet
  std::atomic<Daemon> daemon_{Daemon::unknown};
  std::atomic<bool> stops_{false}, is_revoked_{false};
  std::mutex pause_mutex_;
  std::condition_variable paused_;
  std::exception_ptr failed_;  // exception that ended thread_
  std::thread thread_;
};

}  // namespace agnocast::bridge
