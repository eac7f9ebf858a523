// SPDX-License-Identifier: Apache-2.0
//
// Arguments: the command line as values. Pure: the environment comes in as a value.
//
//   agnocast-ctl NOUN [VERB] [NAME…] [OPTION…]
//
// The table of commands.hpp lists the nouns and verbs and the options of each; a plural noun is
// short for its `list`. Values are checked here once, against option.hpp, so that a command finds
// only valid ones.
#pragma once

#include <base/domain.hpp>
#include <base/sockets/socket_path.hpp>
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
  /// Returns the given value, else the option's default, else an empty text.
  std::string text(const Option& option) const;
  /// Return the value as a number; 0 when there is none.
  std::uint64_t whole(const Option& option) const;
  double real(const Option& option) const;
  /// Returns an empty text when there are fewer subjects.
  std::string subject(std::size_t index) const {
    return index < subjects.size() ? subjects[index] : std::string();
  }
};

/// The environment of the command.
struct Surroundings {
  std::optional<std::string> agnocast_socket;
  std::optional<std::string> xdg_runtime_dir;
  std::optional<std::string> ros_domain_id;
  bool has_system_socket = false;  // something exists at /run/agnocast/agnocastd.sock
  bool out_is_terminal = false;
  static Surroundings of_process();
};

/// A text that the user asked for (--help, --version): print it and exit with status 0.
struct Answer {
  std::string text;
};

Outcome<std::variant<Arguments, Answer>> parse_arguments(std::span<const std::string> words,
                                                         std::span<const Command> commands,
                                                         const Surroundings& around);

/// Returns the socket to use: `named` (--socket), else the one that the environment selects.
std::string choose_socket(const std::string& named, const Surroundings& around);

/// Return "agnocast-ctl topic info", and the usage with its subjects: "topic info NAME".
std::string full_name(const Command& command);
std::string usage_of(const Command& command);
std::string plural_of(std::string_view noun);

}  // namespace agnocast::ctl
