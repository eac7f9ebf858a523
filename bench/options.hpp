// SPDX-License-Identifier: Apache-2.0
//
// Options: the command line as values. Pure.
#pragma once

#include <bench/case.hpp>

#include <cstddef>
#include <string>
#include <vector>

namespace agnocast::bench {

struct Options {
  std::vector<std::string> cases;
  Run run;
  bool is_default = true;  ///< a run with the cases' defaults
  std::string json;        ///< file; "-": stdout, and nothing else there; empty: none
  std::string plot;        ///< directory; empty: none
  bool is_list = false;    ///< print the cases and systems
  std::string help;        ///< not empty: print this instead
  std::string error;       ///< not empty: wrong usage, and the remedy
};

/// Parses a command line for these cases. An option, or a system, that no requested case reads is
/// wrong usage: a user of --period must not get figures of another period.
Options parse(const std::vector<std::string>& arguments, const std::vector<Case>& cases);

/// Returns "--rounds --sizes", the options that it reads beside those of every case.
std::string options_text(const Case& one);
bool compares(const Case& one, std::string_view system);
/// Returns all systems of these cases, each name once.
std::vector<SystemName> systems_of(const std::vector<Case>& cases);

/// Parses "64", "10K", "1.5M" (1024 based); 0: not a size.
std::size_t size_of(const std::string& text);
/// Parses "250us", "1ms", "2s"; negative: not a time.
std::chrono::microseconds period_of(const std::string& text);
/// Returns 1048576 as "1 MiB".
std::string size_text(std::size_t bytes);

}  // namespace agnocast::bench
