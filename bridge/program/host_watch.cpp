// SPDX-License-Identifier: Apache-2.0

#include <bridge/program/host_watch.hpp>

#include <bridge/program/pauses.hpp>

#include <chrono>
#include <stdexcept>
#include <utility>

namespace agnocast::bridge {

HostWatch::~HostWatch() {
  stop();
  if (thread_.joinable()) thread_.join();
}

void HostWatch::start() {
  thread_ = std::thread([this] { watch(); });
}

void HostWatch::stop() noexcept {
  {
    const std::lock_guard lock(pause_mutex_);
    stops_ = true;
  }
  paused_.notify_all();
  graph_.interrupt();
  wake_();
}

void HostWatch::revoke() noexcept {
  is_revoked_ = true;
  stop();
}

void HostWatch::join() {
  graph_.interrupt();
  thread_.join();
  if (failed_) std::rethrow_exception(failed_);
  if (is_revoked_) throw std::runtime_error("agnocastd has revoked this process, its log says why");
}

std::optional<GraphSnapshot> HostWatch::take_latest() {
  const std::lock_guard lock(latest_mutex_);
  return std::exchange(latest_, std::nullopt);
}

void HostWatch::daemon_is(bool there, const std::string& why) {
  const Daemon now = there ? Daemon::there : Daemon::away;
  const Daemon before = daemon_.exchange(now);
  if (before == now || (there && before == Daemon::unknown)) return;
  if (there) return log_.write(LogLevel::notice, "agnocastd is there again");
  log_.write(LogLevel::warning, "agnocastd is not there", {{"why", why}});
}

// The marker is notified when agnocastd ends; this thread notices when it is back.
void HostWatch::watch() try {
  using std::chrono::milliseconds;
  while (!stops_) {
    auto now = graph_.wait(has_daemon() ? std::chrono::duration_cast<milliseconds>(no_end)
                                        : daemon_interval);
    if (now && *now) {
      daemon_is(true, "");
      {
        const std::lock_guard lock(latest_mutex_);
        latest_ = std::move(**now);
      }
      wake_();
    } else if (!now) {
      daemon_is(false, text_of(now.error()));
      if (now.error().code == Errc::daemon_not_running) continue;  // wait() has slept already
      std::unique_lock lock(pause_mutex_);
      paused_.wait_for(lock, daemon_interval, [this] { return stops_.load(); });
    }
  }
} catch (const std::exception&) {
  failed_ = std::current_exception();
  stop();
}

}  // namespace agnocast::bridge
