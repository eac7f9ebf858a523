// SPDX-License-Identifier: Apache-2.0
//
// Arguments: the command line as values. Pure but for the environment, which comes in as a value.
//
//   agnocast-ctl NOUN [VERB] [NAME] [OPTION…]
//
// Which nouns and verbs there are, and which options each takes, is the table of commands.hpp; a
// plural noun is short for its `list`.
#pragma once

#include <ctl/problem.hpp>

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <variant>

namespace agnocast::ctl {

struct Command;

enum class Json : std::uint8_t { no, compact, pretty };

struct Arguments {
  const Command* command = nullptr;
  std::string socket;
  Json json = Json::no;
  std::uint64_t domain = 0;
  bool all_domains = false;
  bool types = false;
  bool count = false;
  bool verbose = false;
  bool hidden = false;
  bool follow = false;
  std::uint64_t number = 20;
  std::string name, topic, process;
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

}  // namespace agnocast::ctl
