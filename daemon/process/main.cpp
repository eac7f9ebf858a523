// SPDX-License-Identifier: Apache-2.0
//
// agnocastd: parses options and configuration, then becomes the supervisor or the daemon itself.
//
// Exit status: 0 ended by SIGTERM or SIGINT, or the requested text is printed · 1 it cannot run
// here · 2 wrong usage. A complaint is two lines on stderr; everything else goes through the log.

#include <agnocast/error.hpp>
#include <base/text/log.hpp>
#include <base/text/standard_error.hpp>
#include <daemon/config/config.hpp>
#include <daemon/config/options.hpp>
#include <daemon/process/log_events.hpp>
#include <daemon/process/service.hpp>
#include <daemon/process/supervisor.hpp>
#include <daemon/transport/descriptor_store.hpp>

#include <sys/resource.h>

#include <csignal>
#include <cstdio>
#include <string>
#include <utility>
#include <variant>

namespace agnocast::daemon {
namespace {

// Prints all complaints: what went wrong, and what to do. Returns exit status 1.
int complain(const std::string& what, const std::string& hint) {
  say_on_stderr("agnocastd: " + what + "\nhint: " + hint + "\n");
  return 1;
}

// Prints the requested text on stdout. Returns `status`, or 1 if it cannot be written (full disk).
int print(const std::string& text, int status) {
  std::fputs(text.c_str(), stdout);
  if (std::fflush(stdout) == 0 && std::ferror(stdout) == 0) return status;
  return complain("output: it cannot be written", "df");
}

// A process needs about eight descriptors; the soft limit of 1024 exists for select(), unused here.
void raise_descriptor_limit() noexcept {
  rlimit limit{};
  if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
  limit.rlim_cur = limit.rlim_max;
  ::setrlimit(RLIMIT_NOFILE, &limit);
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
      const std::string code = word_of(Errc::bad_configuration);
      return complain(code + ": " + sentence_of(Errc::bad_configuration),
                      "agnocast-ctl explain " + code);
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
  Log log = Log::to_stderr(log_program, config.daemon.log_level);
  if (options.fd_store == FdStore::own)
    return supervise(argc, argv, config.daemon.watchdog_seconds, log);
  const bool has_manager = options.fd_store == FdStore::manager;
  if (has_manager && !die_with_supervisor()) return 1;
  auto store = has_manager ? DescriptorStore::of_manager() : DescriptorStore::of_nobody();
  if (!store)
    return complain(store.error().code == Errc::invalid_argument
                        ? "--fd-store=manager: no service manager is there to keep descriptors"
                        : "--fd-store: " + text_of(store.error()),
                    "start it with systemd and FileDescriptorStoreMax=, or with --fd-store=own");
  const auto trouble = serve(config, *socket, std::move(*store), log);
  return trouble ? complain(trouble->what, trouble->hint) : 0;
}

}  // namespace
}  // namespace agnocast::daemon

int main(int argc, char** argv) { return agnocast::daemon::run(argc, argv); }
