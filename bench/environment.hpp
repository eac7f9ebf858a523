// SPDX-License-Identifier: Apache-2.0
//
// Environment: where a result comes from. What cannot be read is left out.
#pragma once

#include <nlohmann/json.hpp>

#include <string>
#include <vector>

namespace agnocast::bench {

/// At the beginning. `arguments`: of the command line.
nlohmann::json environment(const std::vector<std::string>& arguments);
/// What is known at the end: the load then, and what was left out.
void complete(nlohmann::json& environment);

/// Of the sources when this was built, "1a2b3c4-dirty"; empty: not known.
extern const char* const revision;

/// What cannot be measured here, and why: said on stderr, once, and kept for complete().
void leave_out(const std::string& what);

/// What of it makes figures doubtful, as sentences for people: a build that is not optimised, a busy machine, …
std::vector<std::string> doubts(const nlohmann::json& environment);

}  // namespace agnocast::bench
