// SPDX-License-Identifier: Apache-2.0
//
// Options: the command line of agnocast-bridge. --help and agnocast-bridge(8) are made from the
// same table. This file does not print or exit: it returns the text and the exit status.
#pragma once

#include <base/text/log.hpp>

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

/// Tells the program to end at once.
struct Exit {
  int status = 0;
  std::string out;  // for stdout
  std::string err;  // for stderr
};

/// Returns "agnocast-bridge: WHAT\nhint: COMMAND\n".
std::string complaint(const std::string& what, const std::string& hint);

/// An option, an environment variable or an exit status, for --help and the manual page.
struct HelpText {
  std::string name;
  std::string value;  // an option's value; empty: none
  std::string meaning;
};
std::vector<HelpText> option_texts();
std::vector<HelpText> environment_texts();
std::vector<HelpText> exit_texts();

/// Returns an Exit with status 0 for --help and --version, with 2 for wrong usage.
std::variant<Options, Exit> parse_options(int argc, const char* const* argv);

/// Returns the configuration file: --config, else that of the --domain, else the common one;
/// nothing if it does not exist. `directory` differs only in tests.
std::optional<std::string> choose_config_file(const Options& options,
                                              const std::string& directory = "/etc/agnocast");

}  // namespace agnocast::bridge
