// SPDX-License-Identifier: Apache-2.0

#include <bridge/program/options.hpp>

#include <agnocast/version.hpp>
#include <base/text/text.hpp>
#include <bridge/program/config.hpp>

#include <CLI/CLI.hpp>

#include <unistd.h>

#include <cstdio>
#include <string_view>

namespace agnocast::bridge {
namespace {

constexpr const char* help_hint = "agnocast-bridge --help";

// The variables that the parser fills.
struct Values {
  std::string config, socket, status_socket, log_level;
  std::uint32_t domain = 0;
  bool check_config = false, version = false;
};

void describe(CLI::App& app, Values& values) {
  app.add_option("--config", values.config,
                 "configuration; default: /etc/agnocast/bridge-N.toml for --domain N, else "
                 "/etc/agnocast/bridge.toml, if that exists")
      ->type_name("FILE");
  app.add_option("--domain", values.domain,
                 "domain of DDS and of the bridged nodes of this host, 0 to 232; default: the "
                 "configuration's, else ROS_DOMAIN_ID, else 0")
      ->check(CLI::Range(0U, domain_max))
      ->type_name("N");
  app.add_option("--socket", values.socket, "the socket of agnocastd; default: AGNOCAST_SOCKET")
      ->type_name("PATH");
  app.add_option("--status-socket", values.status_socket,
                 "the status socket for agnocast-ctl bridge; default: AGNOCAST_BRIDGE_SOCKET, else "
                 "bridge-N.sock in $RUNTIME_DIRECTORY or beside agnocastd's socket")
      ->type_name("PATH");
  app.add_option("--log-level", values.log_level,
                 "error, warning, notice, info (the default) or debug")
      ->type_name("LEVEL");
  app.add_flag("--check-config", values.check_config,
               "check the configuration and CYCLONEDDS_URI, and end");
  app.add_flag("--version", values.version, "print the version and end");
  app.set_help_flag("--help", "print this help and end");
}

std::string section(const char* title, const std::vector<HelpText>& texts) {
  std::string text = std::string(title) + ":\n";
  for (const HelpText& each : texts) {
    std::string name = "  " + each.name;
    name.resize(std::max<std::size_t>(name.size() + 2, 30), ' ');
    text += name + each.meaning + '\n';
  }
  return text;
}

}  // namespace

std::string complaint(const std::string& what, const std::string& hint) {
  return "agnocast-bridge: " + what + "\nhint: " + hint + '\n';
}

std::vector<HelpText> option_texts() {
  Values values;
  CLI::App app;
  describe(app, values);
  std::vector<HelpText> texts;
  for (const CLI::Option* const option : app.get_options()) {
    const bool has_value = option->get_expected_max() != 0;
    // The text after the colon is the check, which the meaning contains as well.
    const std::string value = has_value ? option->get_type_name() : std::string();
    texts.push_back(
        {option->get_name(), value.substr(0, value.find(':')), option->get_description()});
  }
  return texts;
}

std::vector<HelpText> environment_texts() {
  return {
      {"AGNOCAST_SOCKET", "", "the socket of agnocastd"},
      {"AGNOCAST_BRIDGE_SOCKET", "", "the status socket for agnocast-ctl bridge"},
      {"ROS_DOMAIN_ID", "", "the domain"},
      {"ROS_LOCALHOST_ONLY, ROS_AUTOMATIC_DISCOVERY_RANGE, ROS_STATIC_PEERS", "",
       "how far the bridge looks for others, as nodes of ROS 2 do"},
      {"ROS_DISTRO", "",
       "what ROS_LOCALHOST_ONLY means: until Humble and if it is not set, the "
       "loopback device; since Iron, this host"},
      {"CYCLONEDDS_URI", "", "configuration of Cyclone DDS: interfaces, peers, multicast"},
      {"AMENT_PREFIX_PATH", "",
       "directories with libraries of message packages, besides type_paths"},
      {"RUNTIME_DIRECTORY, NOTIFY_SOCKET, WATCHDOG_USEC", "", "set by systemd"},
  };
}

std::vector<HelpText> exit_texts() {
  return {
      {"0", "", "ended by SIGTERM or SIGINT, or printed the requested text"},
      {"1", "", "cannot run here: configuration, DDS, or another bridge of this domain"},
      {"2", "", "wrong usage"},
  };
}

std::variant<Options, Exit> parse_options(int argc, const char* const* argv) {
  Values values;
  CLI::App app(
      "Connects topics and services of this host with a DDS domain, in the way of ROS 2 "
      "nodes.",
      "agnocast-bridge");
  describe(app, values);
  app.footer(section("Signals", {{"SIGHUP", "", "read the configuration again"},
                                 {"SIGTERM, SIGINT", "", "end"}}) +
             '\n' + section("Environment", environment_texts()) + '\n' +
             section("Exit status", exit_texts()));
  try {
    app.parse(argc, argv);
  } catch (const CLI::CallForHelp&) {
    return Exit{0, app.help(), ""};
  } catch (const CLI::ParseError& error) {
    return Exit{2, "", complaint(escaped(error.what()), help_hint)};
  }
  if (values.version) {
    char text[64];
    std::snprintf(text, sizeof text, "agnocast-bridge %d.%d.%d\n", AGNOCAST_VERSION_MAJOR,
                  AGNOCAST_VERSION_MINOR, AGNOCAST_VERSION_PATCH);
    return Exit{0, text, ""};
  }
  Options options;
  options.check_config = values.check_config;
  for (const auto& [name, value, target] :
       {std::tuple("--config", &values.config, &options.config),
        std::tuple("--socket", &values.socket, &options.socket),
        std::tuple("--status-socket", &values.status_socket, &options.status_socket)}) {
    if (app.count(name) == 0) continue;
    if (value->empty())
      return Exit{2, "", complaint(std::string(name) + ": needs a value", help_hint)};
    *target = *value;
  }
  if (app.count("--domain") != 0) options.domain = values.domain;
  if (app.count("--log-level") != 0) {
    options.log_level = log_level_of(values.log_level);
    if (!options.log_level)
      return Exit{2, "",
                  complaint("--log-level: " + in_quotes(values.log_level) +
                                " is not a level; use one of " + std::string(log_level_names),
                            "agnocast-bridge --log-level info")};
  }
  return options;
}

std::optional<std::string> choose_config_file(const Options& options,
                                              const std::string& directory) {
  if (options.config) return options.config;
  // A file that exists but cannot be read is an error for the reader, not a reason to skip it.
  const auto exists = [](const std::string& path) { return ::access(path.c_str(), F_OK) == 0; };
  if (options.domain) {
    const std::string own = directory + "/bridge-" + std::to_string(*options.domain) + ".toml";
    if (exists(own)) return own;
  }
  if (const std::string common = directory + "/bridge.toml"; exists(common)) return common;
  return std::nullopt;
}

}  // namespace agnocast::bridge
