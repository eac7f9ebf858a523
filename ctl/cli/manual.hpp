// SPDX-License-Identifier: Apache-2.0
//
// Manual: pages in mdoc(7), from the tables that help and errors are made from.
#pragma once

#include <ctl/cli/commands.hpp>

#include <span>
#include <string>

namespace agnocast::ctl {

/// agnocast-ctl(1): a section for each command. `date` as mdoc has it: "November 21, 2026".
std::string manual_of(std::span<const Command> commands, const std::string& date);
/// agnocast-errors(7): every code.
std::string manual_of_errors(const std::string& date);

}  // namespace agnocast::ctl
