// SPDX-License-Identifier: Apache-2.0
//
// Readers of the rules in agnocastd.toml: the tables [[access]] and [[thread]]. Only config.cpp
// uses them.
#pragma once

#include <daemon/config/toml_reading.hpp>

#include <cstddef>
#include <vector>

namespace agnocast::daemon {

/// The daemon compares each callback group that a process reports with each rule, so their number
/// bounds the time of that: 20 us for names in full, 5 ms if all 256 begin with a star, have 40
/// characters and the name is as long as it may be. One rule for each of 200 threads fits.
inline constexpr std::size_t thread_rule_count_max = 256;

/// Appends the rules of `node`, the value of the section, in the order of the file. A rule with a
/// mistake is reported and left out.
void read_access_rules(TomlReading& toml, const toml::node& node, std::vector<AccessRule>& rules);
void read_thread_rules(TomlReading& toml, const toml::node& node, std::vector<ThreadRule>& rules);

}  // namespace agnocast::daemon
