// SPDX-License-Identifier: Apache-2.0
//
// Completion: what may stand where the cursor is. The shells' scripts (ctl/completions/) hand over the
// words and print what comes back; everything is known here, from the table of commands and, for names,
// from the daemon. Without one there are no names, and no word about it.
#pragma once

#include <ctl/cli/commands.hpp>

#include <functional>
#include <span>
#include <string>
#include <vector>

namespace agnocast::ctl {

/// Names of one kind, now.
using NameSource = std::function<std::vector<std::string>(Names)>;

/// `words` are those behind the program, the last one as far as it is typed. What may stand for it.
std::vector<std::string> completions_of(std::span<const std::string> words,
                                        std::span<const Command> commands, const NameSource& names);

/// Those of the daemon at this socket; of codes and levels without it.
std::vector<std::string> names_from(const std::string& socket, Names kind);

}  // namespace agnocast::ctl
