// SPDX-License-Identifier: Apache-2.0
//
// Help: the text of --help, made from the table of commands.
#pragma once

#include <ctl/cli/commands.hpp>

#include <span>
#include <string>
#include <string_view>

namespace agnocast::ctl {

/// Return the help of all commands, of one noun, or of one command.
std::string help_of(std::span<const Command> commands, std::string_view noun);
std::string help_of(const Command& command);

/// Returns "-n, --number COUNT".
std::string spelling_of(const Option& option);
/// Returns the option's meaning and its default.
std::string meaning_of(const Option& option);
/// Returns the options that all commands take, as help shows them.
std::span<const Option* const> common_options() noexcept;

}  // namespace agnocast::ctl
