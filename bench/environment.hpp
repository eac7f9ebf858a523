// SPDX-License-Identifier: Apache-2.0
//
// Environment: the origin of a result. Unreadable facts are left out.
#pragma once

#include <nlohmann/json.hpp>

#include <string>
#include <vector>

namespace agnocast::bench {

/// Collects facts at the beginning. `arguments`: of the command line.
nlohmann::json environment(const std::vector<std::string>& arguments);
/// Adds facts known at the end: the load then, and the parts left out.
void complete(nlohmann::json& environment);

/// Revision of the sources at build time, "1a2b3c4-dirty"; empty: unknown.
extern const char* const revision;

/// Reports what cannot be measured here, and why: once on stderr, and kept for complete().
void leave_out(const std::string& what);

/// Returns sentences about facts that make figures doubtful: a build that is not optimised, a
/// busy machine, …
std::vector<std::string> doubts(const nlohmann::json& environment);

}  // namespace agnocast::bench
