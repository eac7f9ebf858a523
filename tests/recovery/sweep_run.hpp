// SPDX-License-Identifier: Apache-2.0
//
// A script of the sweeps as commands, and the result of one run of it.
#pragma once

#include <tests/recovery/sweep_stage.hpp>
#include <tests/support/crash/step_names.hpp>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::sweep {

struct Script {
  const char* name;
  const char* commands;
  bool loses_store() const { return std::strstr(commands, "lose;") != nullptr; }
};

struct Command {
  char who = '*';
  std::string text;  // without who
  std::string what;
  std::uint64_t id = 0;
  std::string topic;  // or a count
  std::uint64_t count() const { return std::strtoull(topic.c_str(), nullptr, 10); }
};

inline std::vector<Command> parse(const char* text) {
  std::vector<Command> commands;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line, ';');) {
    line.erase(0, line.find_first_not_of(' '));
    Command command;
    static constexpr const char* of_all[] = {"sync",  "revoke",    "restart", "lose",
                                             "moved", "connected", "settled"};
    if (std::find(std::begin(of_all), std::end(of_all), line) == std::end(of_all)) {
      command.who = line[0];
      line.erase(0, 2);
    }
    command.text = line;
    std::istringstream words(line);
    words >> command.what >> command.id >> command.topic;
    commands.push_back(command);
  }
  return commands;
}

/// The results of one run that must be equal in another.
struct Run {
  using Names = std::vector<std::uint64_t>;

  std::vector<std::string> answers;  // by command; empty: not given
  std::map<std::uint64_t, std::map<std::uint64_t, Names>>
      got;                                      // subscription → publisher → numbers
  std::map<std::uint64_t, std::size_t> joined;  // subscription → command
  std::map<std::uint64_t, std::uint64_t>
      interrupted;  // publisher → numbers requested from V when it died
  std::map<std::uint64_t, std::uint64_t> acknowledged;  // publisher → numbers
  std::uint64_t committed = 0;                          // of V's requests at its death
  std::optional<std::size_t> noticed_dead;              // before or at this command
  std::size_t last_answer = 0;                          // of V
  std::string wrong;
};

}  // namespace agnocast::sweep
