// SPDX-License-Identifier: Apache-2.0
//
// Environment: where a result comes from. What cannot be read is left out.
#pragma once

#include <nlohmann/json.hpp>

#include <string>
#include <vector>

namespace agnocast::bench {

nlohmann::json environment();

/// What of it makes figures doubtful, as sentences for people: a build that is not optimised, a busy machine, …
std::vector<std::string> doubts(const nlohmann::json& environment);

}  // namespace agnocast::bench
