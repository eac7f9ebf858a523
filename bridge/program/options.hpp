// SPDX-License-Identifier: Apache-2.0
//
// Options: the command line of agnocast-bridge. --help and agnocast-bridge(8) are made from the same table. Nothing
// here prints or exits: what to print and the status are values.
#pragma once

#include <base/log.hpp>

#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

namespace agnocast::bridge {

struct Options {
  std::optional<std::string> config, socket, status_socket;
  std::optional<std::uint32_t> domain;
  std::optional<agnocast::LogLevel> log_level;
  bool check_config = false;
};

/// The program is to end at once.
struct Exit {
  int status = 0;
  std::string out;  // for stdout
  std::string err;  // for stderr
};

/// "agnocast-bridge: what\nhint: command\n"
std::string complaint(const std::string& what, const std::string& hint);

/// An option, a variable of the environment, or an exit status, for --help and the manual page.
struct HelpText {
  std::string name;
  std::string value;  // what an option takes; empty: nothing
  std::string meaning;
};
std::vector<HelpText> option_texts();
std::vector<HelpText> environment_texts();
std::vector<HelpText> exit_texts();

/// Exit status 0 for --help and --version, 2 for wrong usage.
std::variant<Options, Exit> parse_options(int argc, const char* const* argv);

/// The file that is read when --config does not say one: that of the domain which --domain says, else the one of
/// all; nothing when it is not there. `directory` is /etc/agnocast but for tests.
std::optional<std::string> choose_config_file(const Options& options,
                                              const std::string& directory = "/etc/agnocast");

}  // namespace agnocast::bridge
