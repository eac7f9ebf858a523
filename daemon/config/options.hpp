// SPDX-License-Identifier: Apache-2.0
//
// Options: the command line of agnocastd, and the three decisions that need it: which
// configuration, which socket, which runtime directory.
//
//   agnocastd [--socket PATH] [--config FILE] [--foreground] [--log-level LEVEL]
//             [--fd-store=own|manager|none] [--check-config] [--print-config] [--version] [--help]
//
// Nothing here prints or exits: texts and exit status are values for main().
#pragma once

#include <daemon/config/config.hpp>

#include <tl/expected.hpp>

#include <sys/types.h>

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace agnocast::daemon {

/// The keeper of descriptors across a death of the daemon.
enum class FdStore : std::uint8_t {
  own,      // the daemon's own supervisor, which this process becomes
  manager,  // the parent process: systemd, or the daemon's supervisor
  none,     // no keeper
};
inline constexpr std::string_view fd_store_names = "own, manager, none";

struct Options {
  std::optional<std::string> socket;
  std::optional<std::string> config;
  std::optional<LogLevel> log_level;
  FdStore fd_store = FdStore::own;
  bool foreground = false;
  bool check_config = false;
  bool print_config = false;
};

/// The program is to end at once.
struct Exit {
  int status = 0;
  std::string out;  // for stdout
  std::string err;  // for stderr
};

/// A mistake on the command line, in the two lines that all programs of agnocast use.
struct UsageError {
  std::string what;
  std::string why;
  std::string hint;  // a command

  /// "agnocastd: what: why\nhint: command\n"
  std::string text() const;
};

/// One option as --help and the manual page show it; `value` is empty if it takes none.
struct OptionText {
  std::string name;
  std::string value;
  std::string meaning;
};
std::vector<OptionText> option_texts();

/// Returns exit status 0 for --help and --version, 2 for wrong usage.
std::variant<Options, Exit> parse_options(int argc, const char* const* argv);

/// The environment that decides where things lie.
struct Surroundings {
  uid_t euid = 0;
  std::optional<std::string> xdg_runtime_dir;
  std::optional<std::string> agnocast_socket;
  /// Returns that of this process: geteuid, XDG_RUNTIME_DIR, AGNOCAST_SOCKET.
  static Surroundings of_process();
};

inline constexpr const char* default_config_file = "/etc/agnocast/agnocastd.toml";

/// Returns --config, else `default_file` if it exists; nothing: use the defaults.
std::optional<std::string> choose_config_file(
    const Options& options, const std::string& default_file = default_config_file);

/// Returns --socket, else AGNOCAST_SOCKET, else [daemon] socket, else the user's default:
/// /run/agnocast/agnocastd.sock for root, $XDG_RUNTIME_DIR/agnocast/agnocastd.sock for others.
[[nodiscard]] tl::expected<std::string, UsageError> choose_socket(const Options& options,
                                                                  const Config& config,
                                                                  const Surroundings& around);

/// Returns [daemon] runtime_directory, else the directory of the socket.
std::string choose_runtime_directory(const Config& config, std::string_view socket);

}  // namespace agnocast::daemon
