// SPDX-License-Identifier: Apache-2.0
//
// Arguments: the command line as values. Pure but for the environment, which comes in as a value.
//
//   agnocast-ctl NOUN [VERB] [NAME…] [OPTION…]
//
// Which nouns and verbs there are, and which options each takes, is the table of commands.hpp; a
// plural noun is short for its `list`. Values are checked here once, against what option.hpp says of
// them, so a command asks and never finds nonsense.
#pragma once

#include <ctl/cli/option.hpp>
#include <ctl/cli/problem.hpp>

#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <variant>
#include <vector>

namespace agnocast::ctl {

struct Command;

/// Where the daemon that root starts listens.
inline constexpr const char* system_socket = "/run/agnocast/agnocastd.sock";
/// Where any other user's does, in $XDG_RUNTIME_DIR.
inline constexpr const char* user_socket = "/agnocast/agnocastd.sock";
// ROS 2's own bound; a higher one has no DDS ports.
inline constexpr std::uint64_t domain_max = 232;

enum class Json : std::uint8_t { no, compact, pretty };

struct Arguments {
  const Command* command = nullptr;
  std::string socket;
  Json json = Json::no;
  std::uint64_t domain = 0;
  bool all_domains = false;
  std::vector<std::string> subjects;
  std::vector<std::string> words;  // as they were typed
  std::map<const Option*, std::string> given;

  bool has(const Option& option) const { return given.count(&option) != 0; }
  /// The value that was given, else the option's own, else an empty text.
  std::string text(const Option& option) const;
  /// The same as numbers; 0 when there is none.
  std::uint64_t whole(const Option& option) const;
  double real(const Option& option) const;
  /// Empty when there are fewer.
  std::string subject(std::size_t index) const {
    return index < subjects.size() ? subjects[index] : std::string();
  }
};

/// What is outside of us.
struct Surroundings {
  std::optional<std::string> agnocast_socket;
  std::optional<std::string> xdg_runtime_dir;
  std::optional<std::string> ros_domain_id;
  bool has_system_socket = false;  // there is something at /run/agnocast/agnocastd.sock
  bool out_is_terminal = false;
  static Surroundings of_process();
};

/// A text that was asked for (--help, --version): print it and end well.
struct Answer {
  std::string text;
};

Outcome<std::variant<Arguments, Answer>> parse_arguments(std::span<const std::string> words,
                                                         std::span<const Command> commands,
                                                         const Surroundings& around);

/// The socket that is meant: the one that is named (--socket), else as the environment says.
std::string choose_socket(const std::string& named, const Surroundings& around);

/// "agnocast-ctl topic info", and with what stands behind it: "agnocast-ctl topic info NAME".
std::string full_name(const Command& command);
std::string usage_of(const Command& command);
std::string plural_of(std::string_view noun);

}  // namespace agnocast::ctl
