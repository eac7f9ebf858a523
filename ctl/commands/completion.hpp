// SPDX-License-Identifier: Apache-2.0
//
// Completion: the words that may stand at the cursor. The shell scripts (ctl/completions/) pass
// the words and print the result; this file derives it from the table of commands and, for names,
// from the daemon. Without a daemon it offers no names and prints no error.
#pragma once

#include <ctl/cli/commands.hpp>

#include <functional>
#include <span>
#include <string>
#include <vector>

namespace agnocast::ctl {

/// Returns the current names of one kind.
using NameSource = std::function<std::vector<std::string>(Names)>;

/// Returns the words that may replace the last of `words`, the arguments up to the cursor.
std::vector<std::string> completions_of(std::span<const std::string> words,
                                        std::span<const Command> commands, const NameSource& names);

/// Returns the names that the daemon at this socket knows; codes and levels need no daemon.
std::vector<std::string> names_from(const std::string& socket, Names kind);

}  // namespace agnocast::ctl
