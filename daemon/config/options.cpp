// SPDX-License-Identifier: Apache-2.0

#include <agnocast/abi/fingerprint.hpp>
#include <agnocast/version.hpp>
#include <base/sockets/socket_path.hpp>
#include <base/sockets/unix_address.hpp>
#include <base/text/text.hpp>
#include <daemon/config/options.hpp>

#include <CLI/CLI.hpp>

#include <unistd.h>

#include <array>
#include <cstdio>
#include <cstdlib>

namespace agnocast::daemon {
namespace {

constexpr std::string_view known_options[] = {"--socket",    "--config",       "--foreground",
                                              "--log-level", "--check-config", "--print-config",
                                              "--fd-store",  "--version",      "--help"};
constexpr const char* help_hint = "agnocastd --help";

Exit wrong_usage(std::string what, std::string why, std::string hint) {
  return {2, "", UsageError{std::move(what), std::move(why), std::move(hint)}.text()};
}

std::string version_text() {
  std::array<char, 64> text;
  std::snprintf(text.data(), text.size(), "agnocastd %d.%d.%d (layout %016llx)\n",
                AGNOCAST_VERSION_MAJOR, AGNOCAST_VERSION_MINOR, AGNOCAST_VERSION_PATCH,
                static_cast<unsigned long long>(abi::fingerprint()));
  return text.data();
}

std::optional<std::string> environment(const char* name) {
  const char* const value = ::secure_getenv(name);
  if (value == nullptr || *value == '\0') return std::nullopt;
  return value;
}

tl::expected<std::string, UsageError> checked(std::string path, const char* what) {
  if (const auto address = unix_address(path); !address) {
    return tl::unexpected(
        UsageError{what, address.error().what, std::string("agnocastd --socket ") + system_socket});
  }
  return path;
}

// The variables that the parser writes to.
struct Values {
  std::string socket, config, level, fd_store;
  bool foreground = false, check_config = false, print_config = false, version = false;
};

void describe_options(CLI::App& app, Values& values) {
  app.allow_extras();  // so that the error can name the unknown option, and the one that was meant
  app.add_option("--socket", values.socket, "where clients connect")->type_name("PATH");
  app.add_option("--config", values.config,
                 std::string("configuration; ") + default_config_file + " if it exists")
      ->type_name("FILE");
  app.add_flag("--foreground", values.foreground,
               "stay in the foreground; it always does, so this changes nothing");
  app.add_option("--log-level", values.level, std::string(log_level_names))->type_name("LEVEL");
  app.add_option("--fd-store", values.fd_store,
                 "keeper of memory and identities across restarts: own (a supervisor, the "
                 "default), manager (systemd; the default if it sets $FDSTORE), none")
      ->type_name("WHO")
      ->take_last();
  app.add_flag("--check-config", values.check_config, "check the configuration and end");
  app.add_flag("--print-config", values.print_config, "print the effective configuration and end");
  app.add_flag("--version", values.version, "print version and layout of shared memory and end");
  app.set_help_flag("--help", "print this and end");
  for (CLI::Option* const option : app.get_options()) {
    if (option->get_expected_max() == 0) option->disable_flag_override();
  }
}

}  // namespace

std::string UsageError::text() const {
  return "agnocastd: " + what + ": " + why + "\nhint: " + hint + '\n';
}

std::vector<OptionText> option_texts() {
  Values values;
  CLI::App app;
  describe_options(app, values);
  std::vector<OptionText> texts;
  for (const CLI::Option* const option : app.get_options()) {
    const bool has_value = option->get_expected_max() != 0;
    texts.push_back({option->get_name(), has_value ? option->get_type_name() : std::string(),
                     option->get_description()});
  }
  return texts;
}

std::variant<Options, Exit> parse_options(int argc, const char* const* argv) {
  Values values;
  CLI::App app(
      "The daemon of agnocast: registers publishers and subscriptions, cleans up after dead "
      "processes.",
      "agnocastd");
  describe_options(app, values);
  try {
    app.parse(argc, argv);
  } catch (const CLI::CallForHelp&) {
    return Exit{0, app.help(), ""};
  } catch (const CLI::ArgumentMismatch& error) {
    // "--socket: 1 required PATH missing", or "foreground was given a disallowed flag override".
    const std::string text = error.what();
    if (const std::size_t colon = text.find(':'); colon != std::string::npos)
      return wrong_usage(escaped(text.substr(0, colon)), "needs exactly one value", help_hint);
    return wrong_usage("--" + escaped(text.substr(0, text.find(' '))), "takes no value", help_hint);
  } catch (const CLI::ParseError& error) {
    return wrong_usage("command line", escaped(error.what()), help_hint);
  }

  for (const std::string& extra : app.remaining()) {
    if (extra.size() < 2 || extra[0] != '-')
      return wrong_usage(escaped(extra), "agnocastd takes options only", help_hint);
    const std::string name = extra.substr(0, extra.find('='));
    const std::string_view meant = nearest(name, known_options);
    return wrong_usage(escaped(name), "unknown option",
                       meant.empty() ? std::string(help_hint) : "agnocastd " + std::string(meant));
  }
  if (values.version) return Exit{0, version_text(), ""};

  Options options;
  options.foreground = values.foreground;
  options.check_config = values.check_config;
  options.print_config = values.print_config;
  for (const auto& [name, value, target] :
       {std::tuple("--socket", &values.socket, &options.socket),
        std::tuple("--config", &values.config, &options.config)}) {
    if (app.count(name) == 0) continue;
    // "--socket --foreground": the value is missing. A path like that is written ./--foreground.
    if (value->empty() || value->starts_with("--"))
      return wrong_usage(name, "needs exactly one value", help_hint);
    *target = *value;
  }
  if (app.count("--log-level") != 0) {
    options.log_level = log_level_of(values.level);
    if (!options.log_level) {
      const std::string why =
          in_quotes(values.level) + " is not a log level; known: " + std::string(log_level_names);
      return wrong_usage("--log-level", why, "agnocastd --log-level info");
    }
  }
  if (app.count("--fd-store") == 0) {
    options.fd_store = environment("FDSTORE") ? FdStore::manager : FdStore::own;
  } else if (values.fd_store == "own") {
    options.fd_store = FdStore::own;
  } else if (values.fd_store == "manager") {
    options.fd_store = FdStore::manager;
  } else if (values.fd_store == "none") {
    options.fd_store = FdStore::none;
  } else {
    const std::string why =
        in_quotes(values.fd_store) + " is not valid; known: " + std::string(fd_store_names);
    return wrong_usage("--fd-store", why, "agnocastd --fd-store=own");
  }
  return options;
}

Surroundings Surroundings::of_process() {
  return {::geteuid(), environment("XDG_RUNTIME_DIR"), environment("AGNOCAST_SOCKET")};
}

std::optional<std::string> choose_config_file(const Options& options,
                                              const std::string& default_file) {
  if (options.config) return options.config;
  // A file that exists but cannot be read is an error, not a reason to use the defaults.
  if (::access(default_file.c_str(), F_OK) != 0) return std::nullopt;
  return default_file;
}

tl::expected<std::string, UsageError> choose_socket(const Options& options, const Config& config,
                                                    const Surroundings& around) {
  if (options.socket) return checked(*options.socket, "--socket");
  if (around.agnocast_socket) return checked(*around.agnocast_socket, "AGNOCAST_SOCKET");
  if (!config.daemon.socket.empty()) return config.daemon.socket;
  if (around.euid == 0) return system_socket;
  if (around.xdg_runtime_dir)
    return checked(*around.xdg_runtime_dir + user_socket, "XDG_RUNTIME_DIR");
  return tl::unexpected(UsageError{"socket", "not root, and XDG_RUNTIME_DIR is not set",
                                   "agnocastd --socket /path/to/agnocastd.sock"});
}

std::string choose_runtime_directory(const Config& config, std::string_view socket) {
  if (!config.daemon.runtime_directory.empty()) return config.daemon.runtime_directory;
  const std::size_t slash = socket.rfind('/');
  if (slash == std::string_view::npos) return ".";
  return slash == 0 ? "/" : std::string(socket.substr(0, slash));
}

}  // namespace agnocast::daemon
