// SPDX-License-Identifier: Apache-2.0
//
// agnocastd: options, configuration, the place where clients find it, and the loop.
//
// Exit status: 0 ended by SIGTERM or SIGINT, or what was asked for is printed · 1 it cannot run
// here · 2 wrong usage. A complaint is two lines on stderr; everything else goes through the log.

#include <daemon/broker.hpp>
#include <daemon/config.hpp>
#include <daemon/log.hpp>
#include <daemon/options.hpp>

#include <grp.h>
#include <sys/epoll.h>
#include <sys/random.h>
#include <sys/resource.h>
#include <sys/signalfd.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/sysinfo.h>
#include <sys/un.h>
#include <unistd.h>

#include <bit>
#include <cerrno>
#include <csignal>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <string>
#include <utility>
#include <variant>

namespace agnocast::daemon {
namespace {

// One place where complaints leave: what went wrong, and what to do.
int complain(const std::string& what, const std::string& hint) {
  std::fprintf(stderr, "agnocastd: %s\nhint: %s\n", what.c_str(), hint.c_str());
  return 1;
}

int complain(const Failure& failure) {
  std::string what = failure.what;
  if (failure.os_errno != 0) what += std::string(": ") + std::strerror(failure.os_errno);
  return complain(what, remedy_of(failure.code));
}

// What was asked for, on stdout; a disk that is full is no success.
int print(const std::string& text, int status) {
  std::fputs(text.c_str(), stdout);
  if (std::fflush(stdout) == 0 && std::ferror(stdout) == 0) return status;
  return complain("output: it cannot be written", "df");
}

// systemd's notification protocol (sd_notify(3)): one datagram. Without NOTIFY_SOCKET nobody asks.
void notify(const char* state) noexcept {
  const char* const path = std::getenv("NOTIFY_SOCKET");
  if (path == nullptr || (path[0] != '/' && path[0] != '@')) return;
  sockaddr_un address{};
  const std::size_t length = std::strlen(path);
  if (length >= sizeof address.sun_path) return;
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path, path, length);
  if (path[0] == '@') address.sun_path[0] = '\0';
  const UniqueFd fd(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  static_cast<void>(::sendto(fd.get(), state, std::strlen(state), MSG_NOSIGNAL,
                             reinterpret_cast<const sockaddr*>(&address),
                             static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + length)));
}

// About eight descriptors per process; the soft limit of 1024 is select()'s, not ours.
void raise_descriptor_limit() noexcept {
  rlimit limit{};
  if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
  limit.rlim_cur = limit.rlim_max;
  ::setrlimit(RLIMIT_NOFILE, &limit);
}

// The stack lies at the top of the user's addresses, so one of its addresses says how many bits
// there are.
unsigned address_bits() noexcept {
  const int here = 0;
  return static_cast<unsigned>(std::bit_width(reinterpret_cast<std::uintptr_t>(&here)));
}

std::uint64_t memory_bytes() noexcept {
  struct sysinfo info {};
  return ::sysinfo(&info) == 0 ? std::uint64_t{info.totalram} * info.mem_unit : 0;
}

// Two lives of the daemon must not have the same, or a client would take a new board for its own.
std::uint64_t random_incarnation() noexcept {
  std::uint64_t value = 0;
  if (::getrandom(&value, sizeof value, 0) != sizeof value || value == 0) {
    timespec now{};
    ::clock_gettime(CLOCK_MONOTONIC, &now);
    value = static_cast<std::uint64_t>(now.tv_sec) << 32 ^ static_cast<std::uint64_t>(now.tv_nsec) ^
            static_cast<std::uint64_t>(::getpid()) << 48;
  }
  return value;
}

std::optional<gid_t> group_of(const std::string& name) {
  // getgrnam also reads files and may ask the network; once, at the start.
  const group* const found = ::getgrnam(name.empty() ? "agnocast" : name.c_str());
  if (found == nullptr) return std::nullopt;
  return found->gr_gid;
}

// SIGTERM and SIGINT as events, so that the end happens between two others.
Result<UniqueFd> watch_signals() noexcept {
  sigset_t wanted;
  ::sigemptyset(&wanted);
  ::sigaddset(&wanted, SIGTERM);
  ::sigaddset(&wanted, SIGINT);
  if (::sigprocmask(SIG_BLOCK, &wanted, nullptr) != 0)
    return fail(Errc::os_failure, "blocking signals", errno);
  UniqueFd fd(::signalfd(-1, &wanted, SFD_CLOEXEC | SFD_NONBLOCK));
  if (!fd) return fail(Errc::os_failure, "watching signals", errno);
  return fd;
}

int serve(const Config& config, const std::string& socket, Log& log) {
  const auto arena =
      plan_arena({config.heap.arena_base, config.heap.arena_bytes, config.heap.window_bytes},
                 address_bits(), memory_bytes());
  if (!arena)
    return complain(
        "the arena does not fit into the addresses of this machine",
        "correct arena_base, arena_bytes and window_bytes in [heap] (whole MiB, in steps of 2), or "
        "leave them out");
  const auto group = group_of(config.daemon.socket_group);
  if (!group && !config.daemon.socket_group.empty())
    return complain("there is no group " + config.daemon.socket_group,
                    "groupadd " + config.daemon.socket_group);
  // Only who may give files away gives the socket to the usual group; a configured one is a must.
  const bool wants_group = !config.daemon.socket_group.empty() || ::geteuid() == 0;

  auto signals = watch_signals();
  if (!signals) return complain(signals.error());
  auto dispatcher = Dispatcher::create();
  if (!dispatcher) return complain(dispatcher.error());
  auto listener = Listener::open({socket, choose_runtime_directory(config, socket),
                                  static_cast<mode_t>(config.daemon.socket_mode),
                                  wants_group ? group : std::nullopt});
  if (!listener) return complain(listener.error().what, remedy_of(listener.error().code));
  auto regions = Regions::create();
  if (!regions) return complain(regions.error());

  bool ended = false;
  const auto token = dispatcher->add(signals->get(), EPOLLIN, [&](std::uint32_t) {
    signalfd_siginfo info{};
    if (::read(signals->get(), &info, sizeof info) == sizeof info) ended = true;
  });
  if (!token) return complain(token.error());
  Broker broker({*arena, config}, log, *dispatcher, *listener, std::move(*regions),
                random_incarnation());
  if (auto started = broker.start(); !started) return complain(started.error());
  log.write(LogLevel::notice, "ready",
            {{"socket", socket},
             {"arena_bytes", arena->bytes},
             {"window_bytes", arena->window_bytes},
             {"unprivileged", ::geteuid() == 0 ? "no" : "yes"}});
  notify("READY=1");
  while (!ended) {
    if (auto waited = dispatcher->wait(broker.due_ms()); !waited) return complain(waited.error());
    broker.tick();
  }
  notify("STOPPING=1");
  log.write(LogLevel::notice, "ended");
  log.flush(true);
  return 0;
}

int run(int argc, const char* const* argv) {
  const auto parsed = parse_options(argc, argv);
  if (const auto* const exit = std::get_if<Exit>(&parsed)) {
    std::fputs(exit->err.c_str(), stderr);
    return print(exit->out, exit->status);
  }
  const Options& options = std::get<Options>(parsed);
  Config config;
  if (const auto file = choose_config_file(options)) {
    const auto loaded = load_config(*file);
    if (!loaded) {
      for (const ConfigError& error : loaded.error()) {
        std::fprintf(stderr, "agnocastd: %s\n", error.text().c_str());
        if (!error.remedy.empty()) std::fprintf(stderr, "hint: %s\n", error.remedy.c_str());
      }
      return 1;
    }
    config = *loaded;
  }
  if (options.log_level) config.daemon.log_level = *options.log_level;
  if (options.check_config) return 0;
  if (options.print_config) return print(to_toml(config), 0);
  const auto socket = choose_socket(options, config, Surroundings::of_process());
  if (!socket) {
    std::fputs(socket.error().text().c_str(), stderr);
    return 2;
  }
  std::signal(SIGPIPE, SIG_IGN);
  raise_descriptor_limit();
  Log log = Log::to_stderr(config.daemon.log_level);
  return serve(config, *socket, log);
}

}  // namespace
}  // namespace agnocast::daemon

int main(int argc, char** argv) { return agnocast::daemon::run(argc, argv); }
