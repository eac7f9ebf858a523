// SPDX-License-Identifier: Apache-2.0
//
// Manual: pages in mdoc(7), made from the tables of help and errors.
#pragma once

#include <ctl/cli/commands.hpp>

#include <span>
#include <string>

namespace agnocast::ctl {

/// Returns agnocast-ctl(1), a section a command. `date` in mdoc's form: "November 21, 2026".
std::string manual_of(std::span<const Command> commands, const std::string& date);
/// Returns agnocast-errors(7), with every code.
std::string manual_of_errors(const std::string& date);

}  // namespace agnocast::ctl
