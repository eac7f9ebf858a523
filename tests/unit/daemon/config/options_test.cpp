// SPDX-License-Identifier: Apache-2.0
//
// Goal: every command line is understood or answered in two lines with status 2, and the socket is
// found where users expect it. Method: tables with exact texts; the environment is a value.

#include <agnocast/version.hpp>
#include <daemon/config/options.hpp>

#include "tests/support/machine/temporary_directory.hpp"

#include <gmock/gmock.h>

#include <fstream>
#include <string>
#include <vector>

namespace agnocast::daemon {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

std::variant<Options, Exit> parse_words(std::vector<const char*> arguments) {
  arguments.insert(arguments.begin(), "agnocastd");
  return parse_options(static_cast<int>(arguments.size()), arguments.data());
}

TEST(Options, NothingMeansDefaults) {
  const auto options = std::get<Options>(parse_words({}));
  EXPECT_FALSE(options.socket || options.config || options.log_level);
  EXPECT_FALSE(options.foreground || options.check_config || options.print_config);
}

TEST(Options, AreAllRead) {
  const auto options =
      std::get<Options>(parse_words({"--socket", "/tmp/s", "--config=/tmp/c.toml", "--foreground",
                                     "--log-level", "debug", "--check-config", "--print-config"}));
  EXPECT_EQ(options.socket, "/tmp/s");
  EXPECT_EQ(options.config, "/tmp/c.toml");
  EXPECT_EQ(options.log_level, LogLevel::debug);
  EXPECT_TRUE(options.foreground && options.check_config && options.print_config);
}

TEST(Options, WrongUsageIsTwoLinesAndStatusTwo) {
  const struct {
    std::vector<const char*> arguments;
    const char* text;
  } rows[] = {
      {{"--sockte", "/tmp/s"}, "agnocastd: --sockte: unknown option\nhint: agnocastd --socket\n"},
      {{"--log-levle=debug"},
       "agnocastd: --log-levle: unknown option\nhint: agnocastd --log-level\n"},
      {{"--daemonise"}, "agnocastd: --daemonise: unknown option\nhint: agnocastd --help\n"},
      {{"-x"}, "agnocastd: -x: unknown option\nhint: agnocastd --help\n"},
      {{"-h"}, "agnocastd: -h: unknown option\nhint: agnocastd --help\n"},
      {{"start"}, "agnocastd: start: agnocastd takes options only\nhint: agnocastd --help\n"},
      {{""}, "agnocastd: : agnocastd takes options only\nhint: agnocastd --help\n"},
      {{"a\nb"}, "agnocastd: a\\nb: agnocastd takes options only\nhint: agnocastd --help\n"},
      {{"--socket"}, "agnocastd: --socket: needs exactly one value\nhint: agnocastd --help\n"},
      {{"--socket", ""}, "agnocastd: --socket: needs exactly one value\nhint: agnocastd --help\n"},
      {{"--socket", "--foreground"},
       "agnocastd: --socket: needs exactly one value\nhint: agnocastd --help\n"},
      {{"--foreground=maybe"}, "agnocastd: --foreground: takes no value\nhint: agnocastd --help\n"},
      {{"--help=3"}, "agnocastd: --help: takes no value\nhint: agnocastd --help\n"},
      {{"--"}, "agnocastd: --: unknown option\nhint: agnocastd --help\n"},
      {{"--config"}, "agnocastd: --config: needs exactly one value\nhint: agnocastd --help\n"},
      {{"--socket", "/a", "--socket", "/b"},
       "agnocastd: --socket: needs exactly one value\nhint: agnocastd --help\n"},
      {{"--log-level", "loud"},
       "agnocastd: --log-level: \"loud\" is not a log level; known: error, warning, notice, info, "
       "debug\n"
       "hint: agnocastd --log-level info\n"},
  };
  for (const auto& row : rows) {
    const auto result = parse_words(row.arguments);
    const auto* const exit = std::get_if<Exit>(&result);
    ASSERT_NE(exit, nullptr) << row.text;
    EXPECT_EQ(exit->status, 2);
    EXPECT_EQ(exit->out, "");
    EXPECT_EQ(exit->err, row.text);
  }
}

TEST(Options, HelpAndVersionGoToStdoutAndAreASuccess) {
  const auto help = std::get<Exit>(parse_words({"--help"}));
  EXPECT_EQ(help.status, 0);
  EXPECT_EQ(help.err, "");
  for (const char* option : {"--socket PATH", "--config FILE", "--foreground", "--log-level LEVEL",
                             "--check-config", "--print-config", "--version", "--help"})
    EXPECT_THAT(help.out, HasSubstr(option));

  const auto version = std::get<Exit>(parse_words({"--version"}));
  EXPECT_EQ(version.status, 0);
  EXPECT_EQ(version.err, "");
  EXPECT_THAT(version.out, StartsWith("agnocastd " + std::to_string(AGNOCAST_VERSION_MAJOR) + '.' +
                                      std::to_string(AGNOCAST_VERSION_MINOR) + '.' +
                                      std::to_string(AGNOCAST_VERSION_PATCH) + " (layout "));
}

std::string socket_of(const Options& options, const Config& config, const Surroundings& around) {
  const auto socket = choose_socket(options, config, around);
  return socket ? *socket : socket.error().text();
}

TEST(Options, DefaultSocketDependsOnTheUser) {
  EXPECT_EQ(socket_of({}, {}, {0, "/run/user/0", {}}), "/run/agnocast/agnocastd.sock");
  EXPECT_EQ(socket_of({}, {}, {1000, "/run/user/1000", {}}),
            "/run/user/1000/agnocast/agnocastd.sock");
  EXPECT_EQ(socket_of({}, {}, {1000, {}, {}}),
            "agnocastd: socket: not root, and XDG_RUNTIME_DIR is not set\n"
            "hint: agnocastd --socket /path/to/agnocastd.sock\n");
}

TEST(Options, SocketOptionWinsThenEnvironmentThenConfiguration) {
  Options options;
  Config config;
  Surroundings around{0, {}, {}};
  config.daemon.socket = "/configured";
  EXPECT_EQ(socket_of(options, config, around), "/configured");
  around.agnocast_socket = "/environment";
  EXPECT_EQ(socket_of(options, config, around), "/environment");
  options.socket = "/option";
  EXPECT_EQ(socket_of(options, config, around), "/option");
}

TEST(Options, SocketThatTheKernelCannotNameIsRefusedHere) {
  Options options;
  options.socket = "/" + std::string(107, 'x');
  EXPECT_EQ(socket_of(options, {}, {0, {}, {}}),
            "agnocastd: --socket: the path of a socket is longer than 107 bytes\n"
            "hint: agnocastd --socket /run/agnocast/agnocastd.sock\n");
  EXPECT_THAT(socket_of({}, {}, {1000, "/" + std::string(100, 'x'), {}}),
              StartsWith("agnocastd: XDG_RUNTIME_DIR: the path of a socket is longer"));
}

TEST(Options, RuntimeDirectoryIsWhereTheSocketIsUnlessConfigured) {
  Config config;
  EXPECT_EQ(choose_runtime_directory(config, "/run/agnocast/agnocastd.sock"), "/run/agnocast");
  EXPECT_EQ(choose_runtime_directory(config, "/a.sock"), "/");
  EXPECT_EQ(choose_runtime_directory(config, "a.sock"), ".");
  config.daemon.runtime_directory = "/var/run/x";
  EXPECT_EQ(choose_runtime_directory(config, "/run/agnocast/agnocastd.sock"), "/var/run/x");
}

TEST(Options, ConfigurationIsTheNamedOneOrTheUsualOneIfItExists) {
  test::TemporaryDirectory directory;
  const std::string usual = directory.path("agnocastd.toml");
  EXPECT_EQ(choose_config_file({}, usual), std::nullopt);
  std::ofstream(usual) << "\n";
  EXPECT_EQ(choose_config_file({}, usual), usual);
  Options options;
  options.config = "/does/not/exist";
  EXPECT_EQ(choose_config_file(options, usual), "/does/not/exist");
  EXPECT_STREQ(default_config_file, "/etc/agnocast/agnocastd.toml");
}

}  // namespace
}  // namespace agnocast::daemon
