// SPDX-License-Identifier: Apache-2.0
//
// Environment: where a result comes from. What cannot be read is left out.
#pragma once

#include <nlohmann/json.hpp>

#include <string>
#include <vector>

namespace agnocast::bench {

/// `arguments`: of the command line.
nlohmann::json environment(const std::vector<std::string>& arguments);

/// What cannot be measured here, and why: said on stderr, once, and kept for "left_out" of the environment.
void leave_out(const std::string& what);
const std::vector<std::string>& left_out();

/// What of it makes figures doubtful, as sentences for people: a build that is not optimised, a busy machine, …
std::vector<std::string> doubts(const nlohmann::json& environment);

}  // namespace agnocast::bench
