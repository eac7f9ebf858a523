// SPDX-License-Identifier: Apache-2.0
//
// agnocast-bridge: options, configuration, and the bridge until SIGTERM or SIGINT. It reports to a
// service manager, serves its status on a socket, and reads the configuration again on SIGHUP.
//
// Exit status: 0 ended by a signal, or printed the requested text · 1 cannot run here · 2 wrong
// usage.

#include <base/clock.hpp>
#include <base/text/log.hpp>
#include <base/text/standard_error.hpp>
#include <base/text/text.hpp>
#include <bridge/dds/discovery_range.hpp>
#include <bridge/program/bridge.hpp>
#include <bridge/program/config.hpp>
#include <bridge/program/options.hpp>
#include <bridge/program/status_socket.hpp>

#include <systemd/sd-daemon.h>

#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <new>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::bridge {
namespace {

// The loop that answers also moves messages; it answers within milliseconds.
constexpr std::chrono::milliseconds status_patience(1'000);

int complain(const std::string& what, const std::string& hint) {
  say_on_stderr(complaint(what, hint));
  return 1;
}

/// Prints complaint() in pieces, for lack of memory to put them together.
void complain_in_pieces(const char* what, const char* why, const char* hint) noexcept {
  for (const char* const piece : {"agnocast-bridge: ", what, why, "\nhint: ", hint, "\n"})
    (void)say_on_stderr(piece);
}

/// Without memory nothing can be cleaned up; the peers clean up after a dead bridge.
[[noreturn]] void end_at_once(const char* why) noexcept {
  complain_in_pieces("", why, "systemctl status agnocast-bridge");
  std::_Exit(1);
}

agnocast::LogLevel level_of(LogLevel level) {
  switch (level) {
    case LogLevel::error:
      return agnocast::LogLevel::error;
    case LogLevel::warning:
      return agnocast::LogLevel::warning;
    case LogLevel::notice:
      return agnocast::LogLevel::notice;
    case LogLevel::info:
      return agnocast::LogLevel::info;
    case LogLevel::debug:
      break;
  }
  return agnocast::LogLevel::debug;
}

/// The log of all threads. Peers cause events, so the lines of each event and topic are limited.
class SharedLog {
 public:
  explicit SharedLog(agnocast::LogLevel level)
      : log_(agnocast::Log::to_stderr({"agnocast-bridge"}, level)) {}

  void write(LogLevel level, std::string_view event, const Log::Fields& fields) {
    std::string cause(event);
    std::vector<LogField> own;
    for (const auto& [key, value] : fields) {
      own.emplace_back(key, value);
      if (own.size() == 1) cause += ' ' + value;
    }
    const std::lock_guard lock(mutex_);
    log_.flush();
    log_.write_limited(cause, level_of(level), event, std::span<const LogField>(own));
  }
  void set_level(agnocast::LogLevel level) {
    const std::lock_guard lock(mutex_);
    log_.set_level(level);
  }
  void end() {
    const std::lock_guard lock(mutex_);
    log_.flush(true);
  }

 private:
  std::mutex mutex_;
  agnocast::Log log_;
};

/// Returns the file, overridden by the command line, with the domain of the environment.
tl::expected<Config, std::vector<ConfigError>> configuration(const Options& options) {
  Config config;
  if (const auto file = choose_config_file(options)) {
    auto loaded = load_config(*file);
    if (!loaded) return loaded;
    config = std::move(*loaded);
  }
  if (options.domain) config.domain = options.domain;
  if (options.log_level) config.log_level = options.log_level;
  if (!config.domain) {
    const char* const text = ::secure_getenv("ROS_DOMAIN_ID");
    if (text != nullptr && *text != '\0') {
      char* end = nullptr;
      const unsigned long domain = std::strtoul(text, &end, 10);
      if (*end != '\0' || domain > domain_max)
        return tl::unexpected(std::vector<ConfigError>{{"ROS_DOMAIN_ID", 0, 0, "",
                                                        in_quotes(text) + " is not a domain",
                                                        "ROS_DOMAIN_ID=0 agnocast-bridge"}});
      config.domain = static_cast<std::uint32_t>(domain);
    }
  }
  config.bridge.domain = config.domain.value_or(0);
  return config;
}

/// Puts what ROS 2's variables say about discovery before the user's CYCLONEDDS_URI.
/// Returns the variable that limits it, if any.
tl::expected<std::string, DiscoveryRangeError> limit_discovery() {
  const auto variable = [](const char* name) {
    const char* const value = ::secure_getenv(name);
    return std::string(value != nullptr ? value : "");
  };
  const auto range = discovery_range(variable);
  if (!range) return tl::unexpected(range.error());
  if (!range->configuration.empty()) {
    const std::string own = variable("CYCLONEDDS_URI");
    ::setenv("CYCLONEDDS_URI",
             (own.empty() ? range->configuration : range->configuration + ',' + own).c_str(), 1);
  }
  return range->reason;
}

void read_again(const Options& options, const BridgeOptions& before, Bridge& bridge,
                SharedLog& shared, const Log& log) {
  auto config = configuration(options);
  if (!config) {
    for (const ConfigError& error : config.error())
      log.write(LogLevel::warning, "configuration rejected",
                {{"where", error.where()}, {"why", error.what}, {"remedy", error.remedy}});
    return;
  }
  if (config->bridge.domain != before.domain || config->bridge.speak != before.speak ||
      config->bridge.type_paths != before.type_paths)
    log.write(LogLevel::warning, "only a restart changes these keys",
              {{"keys", "domain, discovery_info, type_paths"}});
  shared.set_level(config->log_level.value_or(agnocast::LogLevel::info));
  bridge.set_rules(std::move(config->bridge.rules), config->bridge.otherwise,
                   config->bridge.announce);
  log.write(LogLevel::notice, "configuration read again");
}

/// Call before creating threads, so that only the thread that waits for these signals gets them.
sigset_t block_signals() {
  sigset_t waited;
  sigemptyset(&waited);
  for (const int signal : {SIGTERM, SIGINT, SIGHUP}) sigaddset(&waited, signal);
  ::pthread_sigmask(SIG_BLOCK, &waited, nullptr);
  std::signal(SIGPIPE, SIG_IGN);
  return waited;
}

/// Makes the bridge notify a service manager's watchdog, if there is one.
void tell_watchdog(BridgeOptions& bridge) {
  std::uint64_t watchdog_us = 0;
  if (::sd_watchdog_enabled(0, &watchdog_us) > 0) {
    bridge.alive_interval = std::chrono::microseconds(watchdog_us / 2);
    bridge.alive = [said_ns = std::uint64_t{0}, watchdog_us]() mutable {
      // Every message wakes the loop; the manager is notified four times in an interval.
      const std::uint64_t now_ns = monotonic_ns();
      if (now_ns - said_ns < watchdog_us * 1000 / 4) return;
      said_ns = now_ns;
      (void)::sd_notify(0, "WATCHDOG=1");
    };
  }
}

/// Returns why the bridge ended; empty: by a signal. SIGHUP calls `read_configuration`.
std::string run_until_signal(Bridge& bridge, const sigset_t& waited,
                             const std::function<void()>& read_configuration) {
  std::thread signals([&] {
    for (int signal = 0; ::sigwait(&waited, &signal) == 0 && signal == SIGHUP;) {
      try {
        read_configuration();
      } catch (const std::exception& error) {
        complain_in_pieces("the configuration cannot be read: ", error.what(),
                           "systemctl reload agnocast-bridge");
      }
    }
    bridge.stop();
  });
  std::string failure;
  try {
    if (const auto ended = bridge.run(); !ended) failure = "DDS: " + ended.error().text();
  } catch (const std::bad_alloc& error) {
    end_at_once(error.what());
  } catch (const std::exception& error) {
    failure = error.what();
  }
  (void)::sd_notify(0, "STOPPING=1");
  // The thread waits for it. NOLINTNEXTLINE(bugprone-bad-signal-to-kill-thread)
  ::pthread_kill(signals.native_handle(), SIGTERM);
  signals.join();
  return failure;
}

int run(const Options& options) {
  auto config = configuration(options);
  if (!config) {
    for (const ConfigError& error : config.error())
      complain(error.where() + ": " + error.what, error.remedy);
    return 1;
  }
  const auto limited = limit_discovery();
  if (!limited)
    return complain(limited.error().variable + ": " + limited.error().what, limited.error().remedy);
  if (options.check_config) {
    const std::string fault = fault_in_dds_configuration(config->bridge.domain);
    return fault.empty() ? 0 : complain(fault, "correct it, or: unset CYCLONEDDS_URI");
  }
  const std::string domain = std::to_string(config->bridge.domain);
  // The library takes the socket and the domain from the environment.
  if (options.socket) ::setenv("AGNOCAST_SOCKET", options.socket->c_str(), 1);
  ::setenv("ROS_DOMAIN_ID", domain.c_str(), 1);

  const sigset_t waited = block_signals();

  SharedLog shared(config->log_level.value_or(agnocast::LogLevel::info));
  const Log log([&shared](LogLevel level, std::string_view event, const Log::Fields& fields) {
    shared.write(level, event, fields);
  });
  if (!limited->empty()) log.write(LogLevel::info, "discovery is limited", {{"by", *limited}});
  tell_watchdog(config->bridge);
  const BridgeOptions in_force = config->bridge;
  const char* const variable = ::secure_getenv("AGNOCAST_BRIDGE_SOCKET");
  const std::string path = choose_status_path(
      options.status_socket.value_or(variable == nullptr ? "" : variable), in_force.domain);
  const auto no_status = [&](const StatusSocket::Failure& failure) {
    log.write(LogLevel::warning, "no status socket", {{"path", path}, {"why", failure.why}});
  };
  // Checked first, so that DDS never sees a bridge that may not run here.
  auto taken = StatusSocket::take(path);
  if (!taken && taken.error().is_taken)
    return complain("another agnocast-bridge serves this domain: " + taken.error().why,
                    "agnocast-ctl bridge list --domain " + domain);
  if (!taken) no_status(taken.error());
  auto bridge = Bridge::create(std::move(config->bridge), log);
  if (!bridge)
    return complain("DDS: " + bridge.error().text(), "check CYCLONEDDS_URI and the network");
  const std::unique_ptr<StatusSocket> status = taken ? std::move(*taken) : nullptr;
  if (status != nullptr) {
    const auto listens = status->listen([&bridge] {
      const auto now = (*bridge)->status(status_patience);
      return now ? json_of(*now, monotonic_ns()) : std::string();
    });
    if (!listens) no_status(listens.error());
  }

  // Log before the thread starts, since nothing may throw while it runs; signals wait for it.
  log.write(LogLevel::notice, "ready", {{"domain", domain}});
  (void)::sd_notify(0, ("READY=1\nSTATUS=bridging domain " + domain).c_str());
  const std::string failure = run_until_signal(
      **bridge, waited, [&] { read_again(options, in_force, **bridge, shared, log); });
  if (failure.empty()) log.write(LogLevel::notice, "ended");
  shared.end();
  return failure.empty() ? 0 : complain(failure, "systemctl status agnocast-bridge");
}

}  // namespace
}  // namespace agnocast::bridge

int main(int argc, char** argv) {
  using namespace agnocast::bridge;
  // Threads and destructors of libraries allocate as well.
  std::set_terminate([] {
    try {
      if (const auto thrown = std::current_exception()) std::rethrow_exception(thrown);
    } catch (const std::bad_alloc& error) {
      end_at_once(error.what());
    } catch (...) {
    }
    std::abort();
  });
  try {
    const auto parsed = parse_options(argc, argv);
    if (const auto* const exit = std::get_if<Exit>(&parsed)) {
      std::fputs(exit->out.c_str(), stdout);
      std::fputs(exit->err.c_str(), stderr);
      return std::fflush(stdout) == 0 ? exit->status : 1;
    }
    return run(std::get<Options>(parsed));
  } catch (const std::exception& error) {
    return complain(error.what(), "agnocast-ctl doctor");
  }
}
