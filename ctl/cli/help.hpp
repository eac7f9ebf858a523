// SPDX-License-Identifier: Apache-2.0
//
// Help: what --help prints, from the table of commands.
#pragma once

#include <ctl/cli/commands.hpp>

#include <span>
#include <string>
#include <string_view>

namespace agnocast::ctl {

/// Of everything, or of one noun.
std::string help_of(std::span<const Command> commands, std::string_view noun);
std::string help_of(const Command& command);

/// "-n, --number COUNT".
std::string spelling_of(const Option& option);
/// Its meaning, its words and its default.
std::string meaning_of(const Option& option);
/// The options that all take, as help shows them.
std::span<const Option* const> common_options() noexcept;

}  // namespace agnocast::ctl
