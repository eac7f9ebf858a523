// SPDX-License-Identifier: Apache-2.0
//
// Patterns for topics' names, as the daemon's access rules and the bridge have them:
//
//   *    any characters but a slash        ?   one character but a slash
//   **   any characters
#pragma once

#include <agnocast/export.hpp>

#include <optional>
#include <string>
#include <string_view>

namespace agnocast {

/// Whether a fully qualified name matches a pattern. Any thread; no allocation; time is at most the product
/// of both lengths.
AGNOCAST_PUBLIC bool topic_matches(std::string_view pattern, std::string_view topic) noexcept;
/// Nothing when `pattern` can match a fully qualified name, else what is wrong with it, for people.
AGNOCAST_PUBLIC std::optional<std::string> topic_pattern_problem(std::string_view pattern);

}  // namespace agnocast
